// Steps of a splitting of any order on a patch of a triangular lattice: the strongest peer of magphonon's own kernel, which does no
// more than this scene needs.  It makes no check of any kind.  speed.py compiles it with COUNT coefficients of the law and with
// REAL, float or double; arrays have `stride` numbers for each component, of which the first `pad` are zero, as those after the last slot.

static void __attribute__((noinline)) pull(const REAL *restrict u, REAL *restrict bx, REAL *restrict by, long stride, long s, long e,
                                           long offset, const REAL *restrict c, REAL Rx, REAL Ry, REAL g) {
    const REAL *restrict w = u + stride;
    for (long i = s; i < e; i++) {
        REAL dx = u[i + offset] - u[i], dy = w[i + offset] - w[i], x = (2 * Rx + dx) * dx + (2 * Ry + dy) * dy, p = c[COUNT - 1];
        _Pragma("GCC unroll 32") for (int n = COUNT - 2; n >= 0; n--) p = p * x + c[n];
        REAL H = p * x, G = g + H;
        bx[i] = H * Rx + G * dx;
        by[i] = H * Ry + G * dy;
    }
}

static void __attribute__((noinline)) move(REAL *restrict u, REAL *restrict v, const REAL *restrict b, const REAL *restrict d,
                                           const REAL *restrict f, const REAL *restrict mobility, long s, long e, const long *o,
                                           REAL kick, REAL drift, REAL k) {
    for (long i = s; i < e; i++) {
        REAL force = (b[i - o[0]] - b[i]) + (d[i - o[1]] - d[i]) + (f[i - o[2]] - f[i]) - k * u[i];
        v[i] += kick * mobility[i] * force;
        u[i] += drift * v[i];
    }
}

// Runs of `run` slots, some stages one after the other as far as their bonds allow, while these slots are in the cache.
void steps(REAL *u, REAL *v, REAL *b, const REAL *mobility, long slots, long pad, long stride, const long *offset, const REAL *c,
           const REAL *R, const REAL *g, REAL k, const REAL *kick, const REAL *drift, long stages, long count, long run) {
    long runs = (slots + run - 1) / run, together = 3;
    for (long done = 0; done < count * stages; done += together)
        for (long q = 0; q < runs + together - 1; q++)
            for (long t = 0; t < together && done + t < count * stages; t++) {
                long r = q - t, stage = (done + t) % stages, s = pad + r * run, e = s + run < pad + slots ? s + run : pad + slots;
                if (r < 0 || r >= runs) continue;
                for (int n = 0; n < 3; n++)
                    pull(u, b + 2 * n * stride, b + (2 * n + 1) * stride, stride, s, e, offset[n], c + n * COUNT, R[n], R[3 + n], g[n]);
                for (int x = 0; x < 2; x++)
                    move(u + x * stride, v + x * stride, b + x * stride, b + (2 + x) * stride, b + (4 + x) * stride, mobility, s, e,
                         offset, done + t ? kick[stage] : kick[0] / 2, drift[stage], k);
            }
}
