/* The mass matrix from inertias about the base's origin, summed over subtrees: M_jk = s_j' I_j s_k, joint k above j or j
   itself, s the joint's velocity of the point at the base's origin. The equations of dynamics.py. */
#ifndef MASS_MATRIX_H
#define MASS_MATRIX_H

#include "torque.h"

typedef struct { V3 angular, linear; } Screw;

/* I_world = R I R' + [p . c + p . u] 1 - p c' - u p',   c = R mc, u = c + m p. */
static void about_base(const Motion *body, const Inertia *I, Inertia *out) {
    V3 c = turned(body->R, I->mc), p = body->p, u = add(c, scale(I->m, p)), y[3];
    const V3 rows[3] = {{I->xx, I->xy, I->xz}, {I->xy, I->yy, I->yz}, {I->xz, I->yz, I->zz}};
    for (int k = 0; k < 3; k++) y[k] = turned(body->R, rows[k]);
    const V3 *R = body->R;
    V both = dot(p, c) + dot(p, u);
#define ROTATED(i, k) (y[0].i * R[0].k + y[1].i * R[1].k + y[2].i * R[2].k - p.i * c.k - u.i * p.k)
    *out = (Inertia){I->m, u, ROTATED(x, x) + both, ROTATED(x, y), ROTATED(y, y) + both,
                     ROTATED(x, z), ROTATED(y, z), ROTATED(z, z) + both};
#undef ROTATED
}

INLINE void add_inertia(Inertia *sum, const Inertia *other) {
    sum->m += other->m, sum->mc = add(sum->mc, other->mc);
    sum->xx += other->xx, sum->xy += other->xy, sum->yy += other->yy;
    sum->xz += other->xz, sum->yz += other->yz, sum->zz += other->zz;
}

/* M (dofs, dofs); `composite` and `screw` are room for one of each a body. */
static void composite_mass(const Robot *robot, const Motion *motion, const Inertia *inertia, Inertia *composite, Screw *screw,
                           V *M) {
    memset(M, 0, sizeof(V) * (size_t)(robot->dofs * robot->dofs));
    for (int64_t b = 0; b < robot->bodies; b++) {
        const Motion *body = motion + b + 1;
        about_base(body, inertia + b, composite + b);
        screw[b] = robot->nodes[b].prismatic ? (Screw){zero3(), body->z} : (Screw){body->z, cross(body->p, body->z)};
    }
    for (int64_t b = robot->bodies; b-- > 0;) {
        const Inertia *I = composite + b;
        const Node *node = robot->nodes + b;
        if (node->parent >= 0) add_inertia(composite + node->parent, I);
        V3 turn = screw[b].angular, shift = screw[b].linear;
        V3 spin = add(symmetric(I, turn), cross(I->mc, shift)), momentum = sub(scale(I->m, shift), cross(I->mc, turn));
        for (int64_t above = b; above >= 0; above = robot->nodes[above].parent) {
            V value = dot(screw[above].angular, spin) + dot(screw[above].linear, momentum);
            value *= robot->constants[b].multiplier * robot->constants[above].multiplier;
            int64_t i = node->driver, k = robot->nodes[above].driver;
            M[i * robot->dofs + k] += value;
            if (above != b) M[k * robot->dofs + i] += value;
        }
    }
}

#endif
