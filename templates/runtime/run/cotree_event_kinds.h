/* cotree_event_kinds.h: kinds of events. */
#ifndef COTREE_EVENT_KINDS_H
#define COTREE_EVENT_KINDS_H

/* Kinds of events. A jump selects a mode of a discontinuous expression; its event function is the
 * condition. The event functions of dry friction are the slip rate times the mode, the distances of
 * the force from its limits, a value that is positive while a clutch is engaged, and a load times
 * the sign that its laws assume. Friction on a plane in space has two slip directions but one mode.
 * Its event functions are the angle by which the direction of sliding may still turn, and the
 * components of the friction impulse. */
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
 * rebound speed in excess of the rest threshold. All but the force have the impulse as second
 * target, which they set to the change of speed in an impact. */
#define COTREE_STOP_UPPER 10
#define COTREE_STOP_LOWER 11
#define COTREE_STOP_FORCE 12
#define COTREE_STOP_REBOUND 13

/* A kink of the rates. The event only ends the branch that is frozen during a step. */
#define COTREE_KINK 14

/* A kink at which the slope of a root is infinite on both sides. Its branch value is the half-width
 * of the band around zero within which the root is regularised; it is not positive if there is no
 * band. */
#define COTREE_STEEP_KINK 15

/* Modes of dry friction other than 1 and -1, which are for sliding. */
#define COTREE_FRICTION_STICKS COTREE_F(0.0)
#define COTREE_FRICTION_FREE COTREE_F(2.0) /* the surfaces are not pressed together */

#endif
