// A tone burst in a finite patch of the lattice: m u'' + m (c - g J) u' + K u = F(t), in SI, for the springs alone and with D*.
const SITES = 1300;  // about so many particles in the patch
const FINE = 0.02;  // of the longest stable time step: the motion is then off by less than half a per cent when the push is over
const BALANCED = 1e-9;  // of the force of a bond: what is left of the static forces after relaxation

/** The particles of a structure without those that are gone, where their springs are anchored, with a bond for each near pair. */
function structureOf({x, y, mass_kg, strength, springs_N_per_m, held, reach}, gone) {
  const kept = x.map((_, p) => p).filter(p => !gone.has(String(p))), bonds = [], of = list => kept.map(p => list[p]);
  const patch = {x: of(x), y: of(y), mass: of(mass_kg), strength: of(strength), springs: of(springs_N_per_m),
    held: Uint8Array.from(of(held)), keys: kept.map(String)};
  kept.forEach((_, p) => {
    for (let q = p + 1; q < kept.length; q++) {
      const vector = [patch.x[q] - patch.x[p], patch.y[q] - patch.y[p]];
      if (Math.hypot(...vector) < reach) bonds.push([p, q, 0, vector]);
    }
  });
  return withBonds(patch, bonds, false);
}

function withBonds(patch, bonds, relaxed) {
  const columns = {i: Int32Array.from(bonds, bond => bond[0]), j: Int32Array.from(bonds, bond => bond[1])};
  return {...patch, ...columns, kind: bonds.map(bond => bond[2]), vector: bonds.map(bond => bond[3]), size: patch.x.length, relaxed};
}

/** Particles of the lattice within a hexagon, in spacings; those that lack a neighbour are the held rim. */
function patchOf(data, gone = new Set()) {
  if (data.structure) return structureOf(data.structure, gone);
  const [a, b] = data.cell, area = Math.abs(a[0] * b[1] - a[1] * b[0]) / data.positions.length;
  const apothem = Math.sqrt(SITES * area / (2 * Math.sqrt(3))), middle = mean(data.positions);
  const far = Math.ceil(2 * apothem * Math.max(Math.hypot(...a), Math.hypot(...b)) / (area * data.positions.length));
  const x = [], y = [], mass = [], numbers = new Map(), bonds = [];
  const key = (m, n, j) => `${m},${n},${j}`;
  const sites = [];
  for (let m = -far; m <= far; m++) {
    for (let n = -far; n <= far; n++) {
      data.positions.forEach((position, j) => {
        const [px, py] = [0, 1].map(k => m * a[k] + n * b[k] + position[k] - middle[k]);
        const out = Math.max(Math.abs(py), Math.abs(Math.sqrt(3) * px + py) / 2, Math.abs(Math.sqrt(3) * px - py) / 2);
        if (out > apothem || gone.has(key(m, n, j))) return;
        numbers.set(key(m, n, j), x.length);
        sites.push({m, n, j});
        x.push(px);
        y.push(py);
        mass.push(data.masses_kg[j]);
      });
    }
  }
  const held = new Uint8Array(x.length);
  sites.forEach(({m, n, j}, p) => data.bonds.forEach((bond, kind) => {
    for (const [from, to, sign] of [[bond.i, bond.j, 1], [bond.j, bond.i, -1]]) {
      if (j !== from) continue;
      const other = key(m + sign * bond.shift[0], n + sign * bond.shift[1], to), q = numbers.get(other);
      if (q === undefined) held[p] |= !gone.has(other);
      else if (sign === 1) bonds.push([p, q, kind, bond.direction.map(part => bond.length * part)]);
    }
  }));
  const patch = {x, y, mass, held, strength: x.map(() => 1), keys: sites.map(({m, n, j}) => key(m, n, j))};
  return withBonds(patch, bonds, gone.size === 0);
}

/** The spring under each particle, in N/m. */
function springsOf(patch, state) {
  return patch.springs ?? patch.x.map(() => state.foundation_N_per_m);
}

/** Directions of the bonds, their stiffness along and across in N/m, and lengths in m, of particles at `rest` (m, from the lattice). */
function bondsAt(patch, data, state, rest) {
  const given = bondStiffness(data, state), {force_N, spacing_m} = data.law;
  return patch.kind.map((kind, b) => {
    const p = patch.i[b], q = patch.j[b];
    const [x, y] = patch.vector[b].map((part, k) => state.spacing_m * part + (rest ? rest[2 * q + k] - rest[2 * p + k] : 0));
    const r = Math.hypot(x, y);
    if (data.law.kind === 'table') return [x / r, y / r, ...given[kind], r];
    const force = patch.strength[p] * patch.strength[q] * force_N * (r / spacing_m) ** -state.exponent;
    return [x / r, y / r, state.exponent * force / r, -force / r, r];
  });
}

/** [xx, xy, yy] of each bond: D0 + D* (Eq. 3), or D0 alone. */
function stiffnessOf(bonds, model) {
  const K = new Float64Array(3 * bonds.length);
  bonds.forEach(([nx, ny, along, across], b) => {
    const turning = model === 'complete' ? across : 0;
    K.set([along * nx * nx + turning * ny * ny, (along - turning) * nx * ny, along * ny * ny + turning * nx * nx], 3 * b);
  });
  return K;
}

/** F = -K u, springs under the particles included. */
function pull(patch, K, springs, u, F) {
  for (let k = 0; k < F.length; k++) F[k] = -springs[k >> 1] * u[k];
  const {i, j} = patch;
  for (let b = 0; b < i.length; b++) {
    const p = 2 * i[b], q = 2 * j[b], dx = u[q] - u[p], dy = u[q + 1] - u[p + 1];
    const fx = K[3 * b] * dx + K[3 * b + 1] * dy, fy = K[3 * b + 1] * dx + K[3 * b + 2] * dy;
    F[p] += fx;
    F[p + 1] += fy;
    F[q] -= fx;
    F[q + 1] -= fy;
  }
}

/** Where the static forces of an inverse power balance, by Newton's method; null if the patch buckles on the way. */
function relaxed(patch, data, state) {
  const rest = new Float64Array(2 * patch.size), F = new Float64Array(2 * patch.size), springs = springsOf(patch, state);
  const typical = data.law.force_N * (state.spacing_m / data.law.spacing_m) ** -state.exponent;
  for (let round = 1; round < 40; round++) {
    const share = Math.min(1, round / 8);  // with all of the force at once Newton's method may land on a saddle
    const bonds = bondsAt(patch, data, state, rest).map(([x, y, along, across, r]) => [x, y, share * along, share * across, r]);
    for (let k = 0; k < F.length; k++) F[k] = -springs[k >> 1] * rest[k];
    bonds.forEach(([nx, ny, , across, r], b) => {
      const p = 2 * patch.i[b], q = 2 * patch.j[b], f = -across * r;
      F[p] -= f * nx;
      F[p + 1] -= f * ny;
      F[q] += f * nx;
      F[q + 1] += f * ny;
    });
    patch.held.forEach((held, p) => held && F.fill(0, 2 * p, 2 * p + 2));
    if (share === 1 && Math.max(...F.map(Math.abs)) < BALANCED * typical) return rest;
    const step = solved(patch, stiffnessOf(bonds, 'complete'), springs, F);
    if (!step) return null;
    const most = Math.max(...step.map(Math.abs)), part = Math.min(1, 0.1 * state.spacing_m / most);
    for (let k = 0; k < rest.length; k++) rest[k] += part * step[k];
  }
  return null;
}

/** K^-1 F of the free particles by conjugate gradients; null where K is not positive definite. */
function solved(patch, K, springs, F) {
  const x = new Float64Array(F.length), r = F.slice(), d = F.slice(), Kd = new Float64Array(F.length);
  let rr = dot(r, r);
  const enough = 1e-20 * rr;
  for (let k = 0; k < F.length && rr > enough; k++) {
    pull(patch, K, springs, d, Kd);
    patch.held.forEach((held, p) => held && Kd.fill(0, 2 * p, 2 * p + 2));
    const bend = -dot(d, Kd);
    if (bend <= 0) return null;
    const a = rr / bend;
    for (let c = 0; c < x.length; c++) {
      x[c] += a * d[c];
      r[c] += a * Kd[c];
    }
    const next = dot(r, r);
    for (let c = 0; c < x.length; c++) d[c] = r[c] + next / rr * d[c];
    rr = next;
  }
  return x;
}

function dot(a, b) {
  return a.reduce((sum, part, k) => sum + part * b[k], 0);
}

/** The motion of one model from rest, pushed at one particle. */
class Burst {
  /** `drive`: {source, direction, force_N, carrier_Hz, cycles, damping_per_s, gyration_rad_per_s}. */
  constructor(patch, bonds, model, springs, drive) {
    Object.assign(this, {patch, springs, drive, t: 0});
    this.K = stiffnessOf(bonds, model);
    this.u = new Float64Array(2 * patch.size);
    this.v = new Float64Array(2 * patch.size);
    this.F = new Float64Array(2 * patch.size);
    const most = Float64Array.from(springs);
    bonds.forEach(([, , along, across], b) => {
      for (const p of [patch.i[b], patch.j[b]]) most[p] += 2 * Math.max(along, Math.abs(across));  // Gershgorin
    });
    const highest = Math.sqrt(Math.max(...most.map((k, p) => k / patch.mass[p]))) + Math.abs(drive.gyration_rad_per_s);
    this.step = FINE * 2 / highest;
  }

  get push() {
    const {force_N, carrier_Hz, cycles} = this.drive, phase = 2 * Math.PI * carrier_Hz * this.t;
    return this.t < cycles / carrier_Hz ? force_N * Math.sin(phase) * (1 - Math.cos(phase / cycles)) / 2 : 0;
  }

  /** Half a drift, a kick with the decay and the turn of the velocities in its middle, half a drift: of second order. */
  advance(time) {
    const {patch, u, v, F, K, drive} = this, steps = Math.ceil(time / this.step), dt = time / steps;
    const decay = Math.exp(-drive.damping_per_s * dt), angle = drive.gyration_rad_per_s * dt;
    const cosine = decay * Math.cos(angle), sine = decay * Math.sin(angle), {source, direction} = drive;
    for (let n = 0; n < steps; n++) {
      for (let k = 0; k < u.length; k++) u[k] += dt / 2 * v[k];
      pull(patch, K, this.springs, u, F);
      this.t += dt / 2;
      F[2 * source] += this.push * direction[0];
      F[2 * source + 1] += this.push * direction[1];
      for (let p = 0; p < patch.size; p++) {
        if (patch.held[p]) continue;
        const kick = dt / 2 / patch.mass[p], x = v[2 * p] + kick * F[2 * p], y = v[2 * p + 1] + kick * F[2 * p + 1];
        v[2 * p] = cosine * x + sine * y + kick * F[2 * p];
        v[2 * p + 1] = cosine * y - sine * x + kick * F[2 * p + 1];
      }
      for (let k = 0; k < u.length; k++) u[k] += dt / 2 * v[k];
      this.t += dt / 2;
    }
  }
}
