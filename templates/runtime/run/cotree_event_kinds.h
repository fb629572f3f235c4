/* cotree_event_kinds.h: kinds of events. */
#ifndef COTREE_EVENT_KINDS_H
#define COTREE_EVENT_KINDS_H

/* Kinds of events. JUMP selects a mode of a discontinuous expression; its event function is the
 * condition. Event functions of dry friction are the slip speed times the mode (SLIP), the
 * distances of the force from its limits (FORWARD, BACKWARD), a value that is positive while a
 * clutch is engaged (ENGAGED), and a load times the sign that its laws assume (LOAD). Friction on
 * a plane in space has two slip directions and one mode; its event functions are the angle by
 * which the slip direction may still turn (TURN) and the components of the friction impulse. */
#define COTREE_JUMP 1
#define COTREE_FRICTION_SLIP 2
#define COTREE_FRICTION_FORWARD 3
#define COTREE_FRICTION_BACKWARD 4
#define COTREE_FRICTION_ENGAGED 5
#define COTREE_FRICTION_TURN 6
#define COTREE_FRICTION_FIRST_IMPULSE 7
#define COTREE_FRICTION_SECOND_IMPULSE 8
#define COTREE_FRICTION_LOAD 9

/* Event functions of rigid stops: the gaps, the contact force times the sign of the side, and the
 * rebound speed in excess of the rest threshold. Except for the force, events have the impulse as
 * second target and set it to the change of speed in an impact. */
#define COTREE_STOP_UPPER 10
#define COTREE_STOP_LOWER 11
#define COTREE_STOP_FORCE 12
#define COTREE_STOP_REBOUND 13

/* A kink of the rates. Its event only releases the branch that is frozen during a step. */
#define COTREE_KINK 14

/* A kink at which a root has infinite slope on both sides. Its branch value is the half-width of
 * the band around zero in which the root is regularised; 0 or less: no band. */
#define COTREE_STEEP_KINK 15

/* Modes of dry friction other than 1 and -1, which are for sliding. */
#define COTREE_FRICTION_STICKS COTREE_F(0.0)
#define COTREE_FRICTION_FREE COTREE_F(2.0) /* no normal force acts */

#endif
