/* The practical limit of the machine: R and the sums S of four regressors, WIDTH doubles to a vector, VECTORS of them side by
   side, as gyrocal.propagation derives it. A batch is (steps, GYROS + 1, LANES) of [w_raw dt, dt]; its result is (45, LANES).
   The regressors are the raw rates of three gyros, and 1.
   Only the series for c and d are here, so the caller keeps |w| dt below their limit. */

#include <string.h>

#define WIDTH 8
#define VECTORS 4
#define TILE 2
#define GYROS 3
#define LANES (WIDTH * VECTORS)
#define CHANNELS (GYROS + 1)
typedef double vec __attribute__((vector_size(8 * WIDTH)));
typedef double loose __attribute__((vector_size(8 * WIDTH), aligned(8))); /* what the caller's arrays are aligned to */

static inline __attribute__((always_inline)) vec load(const double *from) { return *(const loose *)from; }

/* tile: phi (0-2), then E = I + c[phi x] + d[phi x]^2 by rows (3-11). */
static inline __attribute__((always_inline)) void sensitivity(const double *in, const double *G, const double *b, vec *tile)
{
    vec dt = load(in + GYROS * LANES), x = b[0] * dt, y = b[1] * dt, z = b[2] * dt;
#pragma GCC unroll 16
    for (int j = 0; j < GYROS; j++) {
        vec h = load(in + j * LANES);
        x += G[j] * h, y += G[GYROS + j] * h, z += G[2 * GYROS + j] * h;
    }
    vec f = x * x + y * y + z * z;
    vec c = 1. / 2 + f * (-1. / 24 + f * (1. / 720 + f * (-1. / 40320 + f * (1. / 3628800))));
    vec d = 1. / 6 + f * (-1. / 120 + f * (1. / 5040 + f * (-1. / 362880 + f * (1. / 39916800))));
    vec dx = d * x, dy = d * y, dz = d * z, cx = c * x, cy = c * y, cz = c * z;
    vec xy = dx * y, xz = dx * z, yz = dy * z, one_xx = 1 - dx * x, yy = dy * y, zz = dz * z;
    tile[0] = x, tile[1] = y, tile[2] = z;
    tile[3] = 1 - yy - zz, tile[4] = xy - cz, tile[5] = xz + cy;
    tile[6] = xy + cz, tile[7] = one_xx - zz, tile[8] = yz - cx;
    tile[9] = xz - cy, tile[10] = yz + cx, tile[11] = one_xx - yy;
}

/* One row of P (0-2) and of S (3-14) over the steps of a tile; the fifteen stay in registers. */
static inline __attribute__((always_inline)) void row(const double *in, vec tile[][VECTORS][12], long v, long size, vec *state)
{
    vec px = state[0], py = state[1], pz = state[2];
    vec s[12];
    for (int k = 0; k < 12; k++) s[k] = state[3 + k];
#pragma GCC unroll 16
    for (long t = 0; t < size; t++, in += CHANNELS * LANES) {
        const vec *e = tile[t][v];
        vec mx = px * e[3] + py * e[6] + pz * e[9];
        vec my = px * e[4] + py * e[7] + pz * e[10];
        vec mz = px * e[5] + py * e[8] + pz * e[11];
        px += my * e[2] - mz * e[1];
        py += mz * e[0] - mx * e[2];
        pz += mx * e[1] - my * e[0];
        for (int q = 0; q < 4; q++) {
            vec h = load(in + q * LANES);
            s[3 * q] += h * mx, s[3 * q + 1] += h * my, s[3 * q + 2] += h * mz;
        }
    }
    state[0] = px, state[1] = py, state[2] = pz;
    for (int k = 0; k < 12; k++) state[3 + k] = s[k];
}

static inline __attribute__((always_inline)) void tile_of_steps(const double *in, const double *G, const double *b, long size,
                                                                vec tile[][VECTORS][12], vec state[3][VECTORS][15])
{
    for (long t = 0; t < size; t++)
        for (long v = 0; v < VECTORS; v++) sensitivity(in + t * CHANNELS * LANES + v * WIDTH, G, b, tile[t][v]);
    for (int i = 0; i < 3; i++)
        for (long v = 0; v < VECTORS; v++) row(in + v * WIDTH, tile, v, size, state[i][v]);
}

static void lanes(const double *in, long steps, const double *G, const double *b, double *out)
{
    vec tile[TILE][VECTORS][12], state[3][VECTORS][15];
    memset(state, 0, sizeof state);
    for (int i = 0; i < 3; i++)
        for (int v = 0; v < VECTORS; v++) state[i][v][i] += 1;
    long first = 0;
    for (; first + TILE <= steps; first += TILE) tile_of_steps(in + first * CHANNELS * LANES, G, b, TILE, tile, state);
    for (; first < steps; first++) tile_of_steps(in + first * CHANNELS * LANES, G, b, 1, tile, state);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int v = 0; v < VECTORS; v++) {
                *(loose *)(out + (3 * i + j) * LANES + v * WIDTH) = state[i][v][j];
                for (int q = 0; q < 4; q++)
                    *(loose *)(out + (9 + 9 * q + 3 * i + j) * LANES + v * WIDTH) = state[i][v][3 + 3 * q + j];
            }
}

/* The pieces of one output, one after another: (P, S) of the whole, turned to R = P^T and P^T S. */
static void join(const double *lanes_out, long piece, long pieces, double *R, double *S_out)
{
    double P[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, S[4][3][3] = {{{0}}};
    for (long last = piece + pieces; piece < last; piece++) {
        const double *out = lanes_out + piece / LANES * 45 * LANES + piece % LANES;
        double new[3][3];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                new[i][j] = 0;
                for (int k = 0; k < 3; k++) {
                    new[i][j] += P[i][k] * out[(3 * k + j) * LANES];
                    for (int q = 0; q < 4; q++) S[q][i][j] += P[i][k] * out[(9 + 9 * q + 3 * k + j) * LANES];
                }
            }
        memcpy(P, new, sizeof P);
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            R[3 * i + j] = P[j][i];
            for (int q = 0; q < 4; q++)
                S_out[9 * q + 3 * i + j] = P[0][i] * S[q][0][j] + P[1][i] * S[q][1][j] + P[2][i] * S[q][2][j];
        }
}

/* R (outputs, 3, 3) and S (outputs, 4, 3, 3); pieces (outputs) are how many lanes lead to each, one after another;
   work (batches, 45, LANES) is the caller's. */
void propagate(const double *packed, long batches, long steps, const double *G, const double *b, const long *pieces,
               long outputs, double *work, double *R, double *S)
{
    for (long batch = 0; batch < batches; batch++)
        lanes(packed + batch * steps * CHANNELS * LANES, steps, G, b, work + batch * 45 * LANES);
    long piece = 0;
    for (long output = 0; output < outputs; output++) {
        join(work, piece, pieces[output], R + 9 * output, S + 36 * output);
        piece += pieces[output];
    }
}
