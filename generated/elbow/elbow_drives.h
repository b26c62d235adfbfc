/*
 * elbow: gears, motors and the kind of output, for the inversion; private. Written by flexgen; see elbow.h.
 */
#ifndef ELBOW_DRIVES_H
#define ELBOW_DRIVES_H

#include "elbow_private.h"

#define ELBOW_POSE 0 /* the output is a pose: position, then rotation */

/* Coordinates with and without motor; q_m = eta q_g where no gear is twisted. */
static const int i_g[ELBOW_NG] = {0, 1};
static const int i_e[1] = {0};
static const int gear_is_rigid[ELBOW_NG] = {0, 0};
static const int gear_is_linear[ELBOW_NG] = {1, 1};
static const real gear_damping[ELBOW_NG] = {1400.0, 600.0}; /* arm side */
static const real eta[ELBOW_NM][ELBOW_NG] = {
    {267.42857142857144, 0.0},
    {0.0, 252.33333333333334}};
static const real eta_inverse[ELBOW_NG][ELBOW_NM] = {
    {0.003739316239316239, 0.0},
    {0.0, 0.003963011889035667}};
static const real rotor_inertia[ELBOW_NM] = {0.0118, 0.0118};

#endif
