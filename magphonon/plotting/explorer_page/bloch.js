// Frequencies and modes of the lattice from its Bloch matrix, C(q)^+ K C(q) + k (Eq. 18), in SI.
/**
 * Stiffness of each bond along and across it in N/m: [phi'', phi'/r].
 * Of an inverse power the force at the spacing of the scene stays what it is, whatever the exponent.
 */
function bondStiffness(data, state) {
  const law = data.law;
  if (law.kind === 'table') return law.stiffness_N_per_m[state.spacing_index];
  return data.bonds.map(bond => {
    const r = bond.length * state.spacing_m;
    const force = law.force_N * (r / law.spacing_m) ** -state.exponent;
    return [state.exponent * force / r, -force / r];
  });
}

/** D0 + D* of each bond (Eq. 3), or D0 alone, in N/m. */
function bondMatrices(data, state, model) {
  return bondStiffness(data, state).map(([along, across], b) => {
    const [nx, ny] = data.bonds[b].direction;
    const turning = model === 'complete' ? across : 0;
    const xy = (along - turning) * nx * ny;
    return [[along * nx * nx + turning * ny * ny, xy], [xy, along * ny * ny + turning * nx * nx]];
  });
}

/** The mass-weighted Bloch matrix at q, {re, im}: two lists of rows, in rad^2/s^2. */
function blochMatrix(data, state, K, q) {
  const size = 2 * data.masses_kg.length;
  const re = zeros(size), im = zeros(size);
  data.bonds.forEach((bond, b) => {
    const phase = 2 * Math.PI * (q[0] * bond.shift[0] + q[1] * bond.shift[1]);
    const cosine = Math.cos(phase), sine = Math.sin(phase);
    for (let x = 0; x < 2; x++) {
      for (let y = 0; y < 2; y++) {
        const ix = 2 * bond.i + x, iy = 2 * bond.i + y, jx = 2 * bond.j + x, jy = 2 * bond.j + y;
        re[ix][iy] += K[b][x][y];
        re[jx][jy] += K[b][x][y];
        re[ix][jy] -= K[b][x][y] * cosine;
        im[ix][jy] -= K[b][x][y] * sine;
        re[jx][iy] -= K[b][x][y] * cosine;
        im[jx][iy] += K[b][x][y] * sine;
      }
    }
  });
  for (let row = 0; row < size; row++) {
    re[row][row] += state.foundation_N_per_m;
    for (let column = 0; column < size; column++) {
      const mass = Math.sqrt(data.masses_kg[row >> 1] * data.masses_kg[column >> 1]);
      re[row][column] /= mass;
      im[row][column] /= mass;
    }
  }
  return {re, im};
}

/** Frequencies in Hz, ascending, for each wavevector of the path; an unstable mode is negative. */
function bandsOf(data, state, model) {
  const K = bondMatrices(data, state, model);
  return data.path.q.map(q => hermitian(blochMatrix(data, state, K, q)).values.map(frequency_Hz));
}

/** One mode: its frequency in Hz and the displacements in one cell, [re, im] of x and y, the largest of length 1. */
function modeOf(data, state, model, q, branch) {
  const {values, re, im} = hermitian(blochMatrix(data, state, bondMatrices(data, state, model), q));
  const roots = data.masses_kg.map(Math.sqrt);
  const shape = roots.map((root, j) => [0, 1].map(x => [re[2 * j + x][branch] / root, im[2 * j + x][branch] / root]));
  const largest = Math.max(...shape.map(u => Math.hypot(...u.flat())));
  return {
    frequency_Hz: frequency_Hz(values[branch]),
    shape: shape.map(u => u.map(part => part.map(value => value / largest))),
  };
}

function frequency_Hz(square) {
  return Math.sign(square) * Math.sqrt(Math.abs(square)) / (2 * Math.PI);
}

/**
 * Eigenvalues of a Hermitian matrix, ascending, and its eigenvectors in columns, by Jacobi's rotations
 * (Golub and Van Loan, Matrix Computations, Sec. 8.5).  Each takes one element above the diagonal to zero.
 */
function hermitian(matrix) {
  const re = matrix.re.map(row => row.slice()), im = matrix.im.map(row => row.slice());
  const size = re.length, vre = zeros(size), vim = zeros(size);
  for (let k = 0; k < size; k++) vre[k][k] = 1;
  const norm = Math.hypot(offDiagonal(re, im), ...re.map((row, k) => row[k]));
  for (let sweep = 0; offDiagonal(re, im) > 1e-15 * norm; sweep++) {
    if (sweep === 30) throw new Error('the eigenvalues did not converge');
    for (let p = 0; p < size; p++) {
      for (let q = p + 1; q < size; q++) rotate(re, im, vre, vim, p, q);
    }
  }
  const order = [...re.keys()].sort((a, b) => re[a][a] - re[b][b]);
  const sorted = rows => rows.map(row => order.map(k => row[k]));
  return {values: order.map(k => re[k][k]), re: sorted(vre), im: sorted(vim)};
}

function offDiagonal(re, im) {
  let sum = 0;
  for (let p = 0; p < re.length; p++) {
    for (let q = p + 1; q < re.length; q++) sum += 2 * (re[p][q] ** 2 + im[p][q] ** 2);
  }
  return Math.sqrt(sum);
}

/** A -> J^+ A J and V -> V J, with J = [[c, s], [-s*, c]] in the rows and columns p and q, so that A_pq becomes zero. */
function rotate(re, im, vre, vim, p, q) {
  const size = Math.hypot(re[p][q], im[p][q]);
  if (size === 0) return;
  const tau = (re[q][q] - re[p][p]) / (2 * size);
  const t = (tau >= 0 ? 1 : -1) / (Math.abs(tau) + Math.hypot(1, tau));
  const c = 1 / Math.hypot(1, t), sx = t * c * re[p][q] / size, sy = t * c * im[p][q] / size;
  rotateColumns(re, im, p, q, c, sx, sy);
  rotateColumns(vre, vim, p, q, c, sx, sy);
  const rp = re[p], ip = im[p], rq = re[q], iq = im[q];
  for (let k = 0; k < rp.length; k++) {  // rows: with the conjugate of J
    const ap = rp[k], bp = ip[k], aq = rq[k], bq = iq[k];
    rp[k] = c * ap - sx * aq + sy * bq;
    ip[k] = c * bp - sx * bq - sy * aq;
    rq[k] = sx * ap + sy * bp + c * aq;
    iq[k] = sx * bp - sy * ap + c * bq;
  }
}

function rotateColumns(re, im, p, q, c, sx, sy) {
  for (let k = 0; k < re.length; k++) {
    const r = re[k], i = im[k], ap = r[p], bp = i[p], aq = r[q], bq = i[q];
    r[p] = c * ap - sx * aq - sy * bq;
    i[p] = c * bp - sx * bq + sy * aq;
    r[q] = sx * ap - sy * bp + c * aq;
    i[q] = sx * bp + sy * ap + c * bq;
  }
}

function zeros(size) {
  return Array.from({length: size}, () => new Float64Array(size));
}
