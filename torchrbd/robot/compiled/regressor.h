/* The regressor: of every body the force and the moment about the base's origin that each inertial parameter needs, of every
   joint their share for the bodies it moves, z . N + (p x z) . F, of a slide z . F. The equations of dynamics.py. */
#ifndef REGRESSOR_H
#define REGRESSOR_H

#include "motion.h"

/* For m, mcx, mcy, mcz; and for Ixx, Ixy, Iyy, Ixz, Iyz, Izz. */
typedef struct { V3 force[4], moment[4], couple[6]; } Columns;

/* F = m a + Rdd mc, N = p x F + (R mc) x a;   N = R I alpha_b + Rd I omega_b, alpha_b and omega_b in the body's axes. */
static void columns_of(const Motion *body, Columns *columns) {
    V3 omega = turned_back(body->R, body->omega), alpha = turned_back(body->R, body->alpha), rate[3];
    columns->force[0] = body->a, columns->moment[0] = cross(body->p, body->a);
    for (int k = 0; k < 3; k++) {
        rate[k] = cross(body->omega, body->R[k]);
        V3 F = columns->force[k + 1] = add(cross(body->alpha, body->R[k]), cross(body->omega, rate[k]));
        columns->moment[k + 1] = add(cross(body->p, F), cross(body->R[k], body->a));
    }
    const V w[3] = {omega.x, omega.y, omega.z}, x[3] = {alpha.x, alpha.y, alpha.z};
    for (int i = 0, column = 0; i < 3; i++)
        for (int k = 0; k <= i; k++, column++) {
            V3 couple = add(scale(x[k], body->R[i]), scale(w[k], rate[i]));
            if (i != k) couple = add(couple, add(scale(x[i], body->R[k]), scale(w[i], rate[k])));
            columns->couple[column] = couple;
        }
}

/* Joint j's entries for body b. */
INLINE void entries(const Motion *joint, int prismatic, const Columns *columns, V *row) {
    V3 lever = cross(joint->p, joint->z);
    for (int k = 0; k < 4; k++)
        row[k] = prismatic ? dot(joint->z, columns->force[k])
                           : dot(joint->z, columns->moment[k]) + dot(lever, columns->force[k]);
    for (int k = 0; k < 6; k++) row[k + 4] = prismatic ? splat(0) : dot(joint->z, columns->couple[k]);
}

/* Y (dofs, 10 bodies, samples), zero before: structural zeros are left alone. Mimic joints add to the row they follow.
   Takes `tiles` of lanes in one go, one after the other in motion and columns, so that what is written lies together. */
static void fill(const Robot *robot, const Motion *motion, const Columns *columns, double *Y, int64_t samples, int64_t left) {
    int coupled = robot->dofs < robot->bodies;
    int64_t tiles = (left + LANES - 1) / LANES;
    for (int64_t j = 0; j < robot->bodies; j++) {
        const Node *node = robot->nodes + j;
        double multiplier = robot->constants[j].multiplier;
        for (int64_t b = j; b < node->end; b++)
            for (int64_t tile = 0; tile < tiles; tile++) {
                const Motion *joint = motion + tile * (robot->bodies + 1) + j + 1;
                const Columns *body = columns + tile * robot->bodies + b;
                int64_t rest = left - tile * LANES;
                int count = rest < LANES ? (int)rest : LANES;
                double *out = Y + (node->driver * robot->bodies + b) * 10 * samples + tile * LANES;
                V row[10];
                if (node->prismatic) entries(joint, 1, body, row);
                else entries(joint, 0, body, row);
                for (int k = 0; k < 10; k++, out += samples)
                    store(out, 1, count, coupled ? load(out, 1, count) + multiplier * row[k] : row[k]);
            }
    }
}

#endif
