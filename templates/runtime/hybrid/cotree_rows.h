/* cotree_rows.h: the table of unilateral constraints.
 *
 * Each row is one constraint: dry friction, the load of a transmission with losses, or a rigid
 * stop. Its mode, a state of the model, selects one of its laws:
 *
 *     friction   0: sticks; 1 or -1: slides forwards or backwards; 2: has no normal force
 *     load       1 or -1: the sign that its laws assume
 *     stop       0: open; 1 or -1: closed at its upper or lower limit
 *
 * A row that sticks or is closed has a force within limits and no relative acceleration. The force
 * of any other row is at a limit. In an impact the same holds for impulses and speeds.
 *
 * Friction on a plane in space is one row with two components, and that of a ball joint has three.
 * In mode 1 it slides in the direction of its slip, which is stored in as many states. */
#ifndef COTREE_ROWS_H
#define COTREE_ROWS_H

#include "cotree_real.h"

/* Largest number of components of a row. */
#define COTREE_COMPONENTS 3

typedef enum cotree_row_type {
    COTREE_ROW_FRICTION,
    COTREE_ROW_LOAD,
    COTREE_ROW_STOP
} cotree_row_type;

typedef struct cotree_row {
    cotree_row_type type;

    /* Indices of events and states; -1: there is none. */
    int event;           /* slip rate of friction, load, or rebound speed of a stop */
    int limits[2];       /* distances of a friction force from its limits; force of a stop */
    int engaged;         /* value that is positive while a clutch is engaged */
    int gaps[2];         /* gaps of a stop at its upper and at its lower limit */
    int direction_event; /* angle by which the direction of sliding may still turn */
    int slips[COTREE_COMPONENTS]; /* events whose last new values are minus the slip */
    int impulses[2];              /* components of the friction impulse on a plane in space */
    int mode_state;
    int direction_states[COTREE_COMPONENTS]; /* direction of sliding in space */
    int speed_states[COTREE_COMPONENTS];     /* changes of speed in an impact */

    struct cotree_row *stop; /* friction at a contact: its stop; NULL: not at a contact */

    /* Current trial of the mode selection. */
    int is_active; /* 1: the complementarity conditions determine the mode */
    cotree_real mode, saved_mode;
    cotree_real slack[2]; /* distances of the force from its limits */
    cotree_real reversal; /* relative speed or acceleration against the mode */
    cotree_real acceleration_scale;

    /* Friction. */
    int is_resticking;                /* 1: sticks again at the time at which its slip began */
    cotree_real slide_start;          /* time at which the slip began */
    cotree_real sliding_acceleration; /* acceleration if all friction slides */
    cotree_real slip_sign;            /* direction of a contact that slides; 0: to be determined */
    cotree_real slip_speed[COTREE_COMPONENTS]; /* slip before the impact */
    /* Direction of sliding in space; components that a row does not have are 0. */
    cotree_real direction[COTREE_COMPONENTS];
    cotree_real saved_direction[COTREE_COMPONENTS];
    cotree_real last_direction[COTREE_COMPONENTS]; /* values in the last iteration */
    cotree_real last_slip[COTREE_COMPONENTS];
    cotree_real gain; /* change of the direction per unit of slip in this iteration */

    /* Stops. */
    cotree_real side;         /* 1 or -1: closed at the upper or lower limit; 0: open */
    cotree_real gap;          /* magnitude of the closed gap */
    cotree_real gap_rate;     /* rate of the closed gap */
    cotree_real largest_rate; /* largest magnitude of the gap rate in the run so far */
    cotree_real rate_terms;   /* magnitude of the terms whose sum is the gap rate, at the start */
    cotree_real largest_acceleration; /* largest magnitude so far */
    cotree_real later_acceleration;   /* acceleration shortly after the event */
    cotree_real required_rate;        /* gap rate that restitution requires after the impact */
    int was_closed;                   /* 1: closed before the impact */
    int impact_role;                  /* see find_impact_roles */
    int ends_at_rest;      /* 1: the rebound speed is below the rest threshold of the stop */
    int restitution_event; /* event whose last new value is the change of speed */

    /* Impulse. */
    int struck_events[COTREE_COMPONENTS]; /* events that prescribe the changes of speed; -1: no
                                             impulse */
    cotree_real kernel_mode;              /* mode passed to the kernels */
} cotree_row;

#endif
