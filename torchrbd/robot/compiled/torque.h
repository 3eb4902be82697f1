/* Torques by recursion from the tips to the base, and the adjoint of it.

   With c = R mc and I in the base's axes, a body needs, about its own origin,
       f = m a + alpha x c + omega x (omega x c),   n = c x a + I alpha + omega x I omega,
   to which it adds what its children need, f and n + r x f; tau = z . n, of a slide z . f. */
#ifndef TORQUE_H
#define TORQUE_H

#include "motion.h"

/* Of one body, in its own axes; or a derivative by it. */
typedef struct { V m; V3 mc; V xx, xy, yy, xz, yz, zz; } Inertia;

typedef struct { V3 f, n, c; } Wrench;

/* What a scalar's derivatives are made of, by body. nu and phi, by n and f of the subtree, are the velocities that the
   weights cause as joint rates; the others are by the motion, theta by a turn of the body; q, qd and qdd by coordinate. */
typedef struct {
    V3 nu, phi, a, alpha, omega, theta, z, r;
    V q, qd, qdd;
} Adjoint;

INLINE V3 symmetric(const Inertia *I, V3 v) {
    return (V3){I->xx * v.x + I->xy * v.y + I->xz * v.z, I->xy * v.x + I->yy * v.y + I->yz * v.z,
                I->xz * v.x + I->yz * v.y + I->zz * v.z};
}

/* pi[0], pi[stride], ...: of one body, 10 parameters of one robot, or of as many as there are lanes. */
INLINE Inertia load_inertia(const double *pi, int64_t parameter, int64_t sample, int count) {
    V v[10];
    for (int k = 0; k < 10; k++) v[k] = sample ? load(pi + k * parameter, sample, count) : splat(pi[k * parameter]);
    return (Inertia){v[0], {v[1], v[2], v[3]}, v[4], v[5], v[6], v[7], v[8], v[9]};
}

static void require(const Robot *robot, const Motion *motion, const Inertia *inertia, Wrench *wrench) {
    for (int64_t b = 0; b < robot->bodies; b++) {
        const Motion *body = motion + b + 1;
        const Inertia *I = inertia + b;
        V3 omega = turned_back(body->R, body->omega), alpha = turned_back(body->R, body->alpha);
        V3 c = turned(body->R, I->mc);
        V3 spin = add(symmetric(I, alpha), cross(omega, symmetric(I, omega)));
        wrench[b + 1].c = c;
        wrench[b + 1].n = add(cross(c, body->a), turned(body->R, spin));
        wrench[b + 1].f = add(add(scale(I->m, body->a), cross(body->alpha, c)), cross(body->omega, cross(body->omega, c)));
    }
    for (int64_t b = robot->bodies; b > 0; b--) {
        Wrench *parent = wrench + robot->nodes[b - 1].parent + 1;
        if (parent == wrench) continue;
        parent->f = add(parent->f, wrench[b].f);
        parent->n = add(parent->n, add(wrench[b].n, cross(motion[b].r, wrench[b].f)));
    }
}

INLINE V torque(const Robot *robot, const Motion *motion, const Wrench *wrench, int64_t b) {
    return dot(motion[b + 1].z, robot->nodes[b].prismatic ? wrench[b + 1].f : wrench[b + 1].n);
}

/* Derivatives of sum_b weight_b tau_b by inertia, added to `sum`, and by the forces: nu and phi. */
static void weigh(const Robot *robot, const Motion *motion, const V *weight, Adjoint *adjoint, Inertia *sum) {
    adjoint[0].nu = adjoint[0].phi = zero3();
    for (int64_t b = 0; b < robot->bodies; b++) {
        const Node *node = robot->nodes + b;
        const Motion *body = motion + b + 1;
        const Adjoint *parent = adjoint + node->parent + 1;
        Adjoint *own = adjoint + b + 1;
        V3 step = scale(weight[b], body->z);
        own->nu = parent->nu, own->phi = add(parent->phi, cross(parent->nu, body->r));
        if (node->prismatic) own->phi = add(own->phi, step);
        else own->nu = add(own->nu, step);
        if (!sum) continue;
        Inertia *I = sum + b;
        V3 nu = own->nu, phi = own->phi, omega = body->omega;
        /* f . phi + n . nu, by mc: a x nu + phi x alpha + omega (omega . phi) - phi (omega . omega). */
        V3 by_c = add(add(cross(body->a, nu), cross(phi, body->alpha)),
                      sub(scale(dot(omega, phi), omega), scale(dot(omega, omega), phi)));
        I->m += dot(phi, body->a);
        I->mc = add(I->mc, turned_back(body->R, by_c));
        /* nu . I alpha + (nu x omega) . I omega. */
        V3 u = turned_back(body->R, nu), x = turned_back(body->R, body->alpha);
        V3 w = turned_back(body->R, omega), v = cross(u, w);
        I->xx += u.x * x.x + v.x * w.x;
        I->xy += u.x * x.y + u.y * x.x + v.x * w.y + v.y * w.x;
        I->yy += u.y * x.y + v.y * w.y;
        I->xz += u.x * x.z + u.z * x.x + v.x * w.z + v.z * w.x;
        I->yz += u.y * x.z + u.z * x.y + v.y * w.z + v.z * w.y;
        I->zz += u.z * x.z + v.z * w.z;
    }
}

/* w x (w x r), differentiated: by w, times y. */
INLINE V3 by_spin(V3 w, V3 r, V3 y) {
    return add(scale(dot(w, r), y), sub(scale(dot(w, y), r), scale(dot(y, r) + dot(y, r), w)));
}

/* Derivatives of sum_b weight_b tau_b by q, qd, qdd of all bodies and, in adjoint[0].a, by the base's acceleration; after
   `require` and `weigh`. A body-fixed vector v of derivative y turns with the body: theta += v x y. */
static void differentiate(const Robot *robot, const Motion *motion, const Inertia *inertia, const Wrench *wrench,
                          const V *weight, Adjoint *adjoint) {
    memset(&adjoint[0].a, 0, sizeof(V3) * 4);
    for (int64_t b = 0; b < robot->bodies; b++) {
        const Node *node = robot->nodes + b;
        const Motion *body = motion + b + 1;
        const Inertia *I = inertia + b;
        Adjoint *own = adjoint + b + 1;
        V3 nu = own->nu, phi = own->phi, omega = body->omega, alpha = body->alpha, c = wrench[b + 1].c;
        V3 mu = cross(nu, omega);
        V3 I_nu = turned(body->R, symmetric(I, turned_back(body->R, nu)));
        V3 I_mu = turned(body->R, symmetric(I, turned_back(body->R, mu)));
        V3 I_omega = turned(body->R, symmetric(I, turned_back(body->R, omega)));
        V3 I_alpha = turned(body->R, symmetric(I, turned_back(body->R, alpha)));
        V3 by_c = add(add(cross(body->a, nu), cross(phi, alpha)), sub(scale(dot(omega, phi), omega), scale(dot(omega, omega), phi)));
        own->a = add(scale(I->m, phi), cross(nu, c));
        own->alpha = add(cross(c, phi), I_nu);
        own->omega = add(add(by_spin(omega, c, phi), I_mu), cross(I_omega, nu));
        own->theta = add(add(cross(c, by_c), add(cross(I_alpha, nu), cross(I_nu, alpha))),
                         add(cross(I_omega, mu), cross(I_mu, omega)));
        own->z = scale(weight[b], node->prismatic ? wrench[b + 1].f : wrench[b + 1].n);
        own->r = cross(wrench[b + 1].f, adjoint[node->parent + 1].nu);
    }
    for (int64_t b = robot->bodies; b-- > 0;) {
        const Node *node = robot->nodes + b;
        const Motion *body = motion + b + 1, *before = motion + node->parent + 1;
        Adjoint *own = adjoint + b + 1, *parent = adjoint + node->parent + 1;
        V3 w = before->omega, moved = node->prismatic ? own->a : own->alpha;
        V twice = splat(node->prismatic ? 2 : 1);
        own->qdd = dot(body->z, moved);
        own->qd = twice * dot(moved, cross(w, body->z));
        own->z = add(own->z, add(scale(body->qdd, moved), scale(twice * body->qd, cross(moved, w))));
        parent->omega = add(parent->omega, scale(twice * body->qd, cross(body->z, moved)));
        if (!node->prismatic) {
            own->qd += dot(body->z, own->omega);
            own->z = add(own->z, scale(body->qd, own->omega));
        }
        own->r = add(own->r, add(cross(own->a, before->alpha), sub(scale(dot(own->a, w), w), scale(dot(w, w), own->a))));
        own->theta = add(own->theta, cross(body->z, own->z));
        own->q = dot(body->z, node->prismatic ? own->r : own->theta);
        parent->a = add(parent->a, own->a);
        parent->alpha = add(parent->alpha, add(own->alpha, cross(body->r, own->a)));
        parent->omega = add(parent->omega, add(own->omega, by_spin(w, body->r, own->a)));
        parent->theta = add(parent->theta, add(own->theta, cross(body->r, own->r)));
    }
}

#endif
