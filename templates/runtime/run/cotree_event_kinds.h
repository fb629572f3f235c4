/* cotree_event_kinds.h: kinds of the events of a model. */
#ifndef COTREE_EVENT_KINDS_H
#define COTREE_EVENT_KINDS_H

/* Kinds of events. A jump chooses a mode of a discontinuous expression; its event function is
 * the condition. The event functions of dry friction are the slip rate with the sign of the
 * mode, the distances of the force to its limits, a value that is positive while a clutch is
 * engaged, and a load with the sign that its laws assume. Friction on a plane in space has two
 * directions of slip and one mode: the angle by which the direction of sliding may still turn, and
 * the components of the friction in an impact. */
#define COTREE_JUMP 1
#define COTREE_FRICTION_SLIP 2
#define COTREE_FRICTION_FORWARD 3
#define COTREE_FRICTION_BACKWARD 4
#define COTREE_FRICTION_ENGAGED 5
#define COTREE_FRICTION_TURN 6
#define COTREE_FRICTION_FIRST_IMPULSE 7
#define COTREE_FRICTION_SECOND_IMPULSE 8
#define COTREE_FRICTION_LOAD 9

/* Event functions of rigid stops: the gaps, the contact force with the sign of the side, and the
 * rebound speed in excess of the rest threshold. All but the force have the impulse as second
 * target, which they set to the change of speed in an impact. */
#define COTREE_STOP_UPPER 10
#define COTREE_STOP_LOWER 11
#define COTREE_STOP_FORCE 12
#define COTREE_STOP_REBOUND 13

/* A kink of the rates: the event only ends the branch that is frozen during a step. */
#define COTREE_KINK 14

/* A kink at which the slope of a root is infinite on both sides. Its branch is the half-width of
 * the band around zero within which the root is replaced; it is not positive if there is none. */
#define COTREE_STEEP_KINK 15

/* Modes of dry friction, besides 1 and -1 of sliding. */
#define COTREE_FRICTION_STICKS COTREE_F(0.0)
#define COTREE_FRICTION_FREE COTREE_F(2.0) /* no normal force presses the faces together */

#endif
