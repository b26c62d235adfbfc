/*
 * elbow: the motion of the coordinates without motor over a mesh of intervals; private.
 */
#ifndef ELBOW_MESH_H
#define ELBOW_MESH_H

#include "elbow_inversion_common.h"
#include "elbow_path.h"
#include "elbow_reduced_problem.h"

/*
 * --- The motion between the Gauss points and nodes of a mesh.
 */

#endif
