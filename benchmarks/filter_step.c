/* The covariance step of the filter in C: what a compiler makes of the same arithmetic as navsim's kernels.
 *
 * P <- Phi P Phi' + Q at every step, and an update by position and velocity (six numbers, Joseph form) each `every`
 * steps. Phi is I but for its nine navigation rows, phi[9][15] = their part of Phi - I, the same at every step.
 * Compiled with WIDTH 1 it works on one run, with another on as many side by side, one to a lane.
 */
#include <math.h>
#include <string.h>

#ifndef WIDTH
#define WIDTH 1
#endif
#if WIDTH == 1
typedef double real;
#define LANE(x, l) (x)
#else
typedef double real __attribute__((vector_size(8 * WIDTH)));
#define LANE(x, l) ((x)[l])
#endif

enum { N = 15, NAV = 9, M = 6, POS = 0, VEL = 3, ATT = 6, GYRO = 9, ACCEL = 12 };

/* densities of white noise of gyros and accelerometers, the interval, variances of position and velocity fixes */
typedef struct {
    double gyro, accel, dt, position, velocity;
} Setting;

static inline __attribute__((always_inline)) void add_white(real p[N][N], const Setting *s)
{
    const double qg = s->gyro * s->dt, qa = s->accel * s->dt, half = 0.5 * s->dt;
    for (int i = 0; i < 3; i++) {
        p[POS + i][POS + i] += half * half * qa;
        p[POS + i][VEL + i] += half * qa;
        p[VEL + i][POS + i] += half * qa;
        p[VEL + i][VEL + i] += qa;
        p[ATT + i][ATT + i] += qg;
    }
}

/* ---- dense: 15 x 15 loops, the six numbers one after the other */

static void multiply(real a[restrict N][N], real b[restrict N][N], real out[restrict N][N])
{
    for (int i = 0; i < N; i++) {
        real sum[N];
        for (int j = 0; j < N; j++)
            sum[j] = a[i][0] * b[0][j];
        for (int k = 1; k < N; k++)
            for (int j = 0; j < N; j++)
                sum[j] += a[i][k] * b[k][j];
        for (int j = 0; j < N; j++)
            out[i][j] = sum[j];
    }
}

static void transpose(real a[N][N], real out[N][N])
{
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++)
            out[j][i] = a[i][j];
}

static void dense_update(real p[N][N], const Setting *s)
{
    real g[N][N], t[N][N], a[N][N], column[N];
    for (int m = 0; m < M; m++) {
        const double r = m < VEL ? s->position : s->velocity;
        const real scale = 1.0 / (p[m][m] + r);
        memset(g, 0, sizeof g);
        for (int i = 0; i < N; i++) {
            column[i] = p[i][m] * scale;
            g[i][i] += 1.0;
            g[i][m] -= column[i];
        }
        multiply(g, p, a);
        transpose(g, t);
        multiply(a, t, p);
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++)
                p[i][j] += column[i] * column[j] * r;
    }
}

void dense_steps(double *p_, const double *phi_, const Setting *s, long steps, long every)
{
    real p[N][N], phi[NAV][N], whole[N][N], across[N][N], a[N][N];
    memcpy(p, p_, sizeof p);
    memcpy(phi, phi_, sizeof phi);
    memset(whole, 0, sizeof whole);
    for (int i = 0; i < N; i++) {
        whole[i][i] += 1.0;
        for (int j = 0; j < N && i < NAV; j++)
            whole[i][j] += phi[i][j];
    }
    transpose(whole, across);
    for (long k = 1; k <= steps; k++) {
        multiply(whole, p, a);
        multiply(a, across, p);
        add_white(p, s);
        if (k % every == 0)
            dense_update(p, s);
    }
    memcpy(p_, p, sizeof p);
}

/* ---- by blocks: only what couples, only one half of what is symmetric, the six numbers at once */

/* out[i][:] <- (Phi p)[i][:] for the rows of one block, which is coupled to `count` blocks of three columns */
static inline __attribute__((always_inline)) void carry(
    real phi[NAV][N], real p[N][N], real out[NAV][N], int row, const int *blocks, int count)
{
    for (int i = row; i < row + 3; i++) {
        real sum[N];
        for (int j = 0; j < N; j++)
            sum[j] = p[i][j];
        for (int b = 0; b < count; b++)
            for (int k = blocks[b]; k < blocks[b] + 3; k++)
                for (int j = 0; j < N; j++)
                    sum[j] += phi[i][k] * p[k][j];
        for (int j = 0; j < N; j++)
            out[i][j] = sum[j];
    }
}

/* p[i][j] <- (a Phi')[i][j] of navigation for the columns of one block and the rows not above it; across: phi' */
static inline __attribute__((always_inline)) void carry_back(
    real across[N][NAV], real a[NAV][N], real p[N][N], int column, const int *blocks, int count)
{
    for (int i = column; i < NAV; i++) {
        real sum[3];
        for (int j = 0; j < 3; j++)
            sum[j] = a[i][column + j];
        for (int b = 0; b < count; b++)
            for (int k = blocks[b]; k < blocks[b] + 3; k++)
                for (int j = 0; j < 3; j++)
                    sum[j] += a[i][k] * across[k][column + j];
        for (int j = 0; j < 3; j++) {
            p[i][column + j] = sum[j];
            p[column + j][i] = sum[j];
        }
    }
}

static const int OF_POS[] = {POS, VEL, ATT, ACCEL}, OF_VEL[] = {POS, VEL, ATT, GYRO, ACCEL},
                 OF_ATT[] = {POS, VEL, ATT, GYRO};

static void block_update(real p[N][N], const Setting *s)
{
    real pht[N][M], l[M][M], k[N][M], work[N][M], reciprocal[M];
    for (int i = 0; i < N; i++)
        for (int a = 0; a < M; a++)
            pht[i][a] = p[i][a];
    for (int a = 0; a < M; a++) {
        for (int b = 0; b <= a; b++) {
            real t = p[a][b];
            if (a == b)
                t += a < VEL ? s->position : s->velocity;
            for (int c = 0; c < b; c++)
                t -= l[a][c] * l[b][c];
            l[a][b] = a == b ? t : t * reciprocal[b];
        }
        for (int lane = 0; lane < WIDTH; lane++)
            LANE(l[a][a], lane) = sqrt(LANE(l[a][a], lane));
        reciprocal[a] = 1.0 / l[a][a];
    }
    for (int i = 0; i < N; i++) {
        for (int a = 0; a < M; a++) {
            real t = pht[i][a];
            for (int b = 0; b < a; b++)
                t -= l[a][b] * k[i][b];
            k[i][a] = t * reciprocal[a];
        }
        for (int a = M - 1; a >= 0; a--) {
            real t = k[i][a];
            for (int b = a + 1; b < M; b++)
                t -= l[b][a] * k[i][b];
            k[i][a] = t * reciprocal[a];
        }
    }
    /* A = P - K (P H')', then A + (K R - A H') K' */
    for (int i = 0; i < N; i++)
        for (int a = 0; a < M; a++)
            for (int j = 0; j <= i; j++)
                p[i][j] -= k[i][a] * pht[j][a];
    for (int i = 0; i < N; i++)
        for (int a = 0; a < M; a++)
            work[i][a] = k[i][a] * (a < VEL ? s->position : s->velocity) - (a <= i ? p[i][a] : p[a][i]);
    for (int i = 0; i < N; i++)
        for (int j = 0; j <= i; j++) {
            real t = p[i][j];
            for (int a = 0; a < M; a++)
                t += work[i][a] * k[j][a];
            p[i][j] = t;
            p[j][i] = t;
        }
}

void block_steps(double *p_, const double *phi_, const Setting *s, long steps, long every)
{
    real p[N][N], phi[NAV][N], across[N][NAV], a[NAV][N];
    memcpy(p, p_, sizeof p);
    memcpy(phi, phi_, sizeof phi);
    for (int i = 0; i < NAV; i++)
        for (int j = 0; j < N; j++)
            across[j][i] = phi[i][j];
    for (long step = 1; step <= steps; step++) {
        carry(phi, p, a, POS, OF_POS, 4);
        carry(phi, p, a, VEL, OF_VEL, 5);
        carry(phi, p, a, ATT, OF_ATT, 4);
        carry_back(across, a, p, POS, OF_POS, 4);
        carry_back(across, a, p, VEL, OF_VEL, 5);
        carry_back(across, a, p, ATT, OF_ATT, 4);
        for (int i = 0; i < NAV; i++)
            for (int j = NAV; j < N; j++) {
                p[i][j] = a[i][j];
                p[j][i] = a[i][j];
            }
        add_white(p, s);
        if (step % every == 0)
            block_update(p, s);
    }
    memcpy(p_, p, sizeof p);
}
