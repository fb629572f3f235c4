/* Times MuJoCo's forward dynamics in a loop over random states.
 * robots_mujoco MODEL SECONDS: MODEL is MJCF; prints the least mean time of a call in ns. */
#include <mujoco/mujoco.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { STATES = 64, ROUNDS = 8 };

static double number(void) { return 2.0 * rand() / RAND_MAX - 1.0; }

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
    static char why[1000];
    double best = 1e30, spent = 0.0, sink = 0.0, *states;
    mjModel *m;
    mjData *d;
    int i, j, n;
    if (argc != 3) return 2;
    m = mj_loadXML(argv[1], NULL, why, sizeof why);
    if (m == NULL) {
        fprintf(stderr, "%s\n", why);
        return 1;
    }
    d = mj_makeData(m);
    n = (int)m->nq + 2 * (int)m->nv;
    states = malloc(sizeof *states * STATES * (size_t)n);
    if (d == NULL || states == NULL) return 1;
    for (i = 0; i < STATES * n; ++i) states[i] = number();
    for (i = 0; i < STATES; ++i) mj_normalizeQuat(m, states + i * n);
    while (spent < atof(argv[2])) {
        const double began = now();
        double took;
        for (j = 0; j < ROUNDS * STATES; ++j) {
            const double *const x = states + j % STATES * n;
            mju_copy(d->qpos, x, (int)m->nq);
            mju_copy(d->qvel, x + m->nq, (int)m->nv);
            mju_copy(d->qfrc_applied, x + m->nq + m->nv, (int)m->nv);
            mj_forward(m, d);
            sink += d->qacc[0];
        }
        took = now() - began;
        best = fmin(best, took / (ROUNDS * STATES));
        spent += took;
    }
    printf("%.1f\n", 1e9 * best);
    return sink == 1.0;
}
