// Measured ridges on the chart: a table with the columns q1, q2 and frequency_Hz, as "magphonon spectrum" writes it.
'use strict';

/** Rows [q1, q2, f] of the table, q in fractions of the reciprocal vectors. */
function readRidges(text) {
  const lines = text.split(/\r?\n/).filter(line => line.trim() && !line.startsWith('#'));
  const comma = lines[0]?.includes(';') ? ';' : ',';
  const [header, ...rows] = lines.map(line => line.match(new RegExp(`("[^"]*"|[^${comma}])*${comma}?`, 'g'))
    .map(cell => cell.replace(comma, '').trim()));
  const columns = ['q1', 'q2', 'frequency_Hz'].map(name => (header ?? []).indexOf(name));
  if (columns.includes(-1) || !rows.length) throw new Error('it has no rows with the columns q1, q2 and frequency_Hz');
  const points = rows.map(row => columns.map(k => Number((row[k] || 'none').replace(',', '.'))));
  const bad = points.findIndex(point => !point.every(Number.isFinite));
  if (bad >= 0) throw new Error(`row ${bad + 1} below the header holds no numbers q1, q2 and frequency_Hz`);
  return points;
}

/** The points that lie on the path of the chart, or would after a turn or reflection that keeps the bands: [place, f]. */
function onPath(data, state, points) {
  const turns = symmetries(data, state), steps = data.path.q.length;
  return points.flatMap(([q1, q2, f]) => {
    let best = {far: 1.5 / steps};  // of 2 pi over the spacing: a step of the path
    for (const turn of turns) {
      const image = turn.map(([a, b]) => a * q1 + b * q2);
      const q = image.map(part => part - Math.round(part));
      for (const shift of [[0, 0], [1, 0], [0, 1], [1, 1], [-1, 0], [0, -1], [-1, -1], [1, -1], [-1, 1]]) {
        best = nearest(data, q.map((part, x) => part + shift[x]), best);
      }
    }
    return best.share === undefined ? [] : [[best.share, f]];
  });
}

/** The place on the path that is nearest to q, if it is nearer than the best so far. */
function nearest(data, q, best) {
  const {axis, jumps, q: path} = data.path;
  for (let k = 1; k < path.length; k++) {
    if (jumps.includes(k) || axis[k] === axis[k - 1]) continue;
    const step = wavevector(data, path[k].map((part, x) => part - path[k - 1][x]));
    const from = wavevector(data, q.map((part, x) => part - path[k - 1][x]));
    const share = Math.min(Math.max((step[0] * from[0] + step[1] * from[1]) / (step[0] ** 2 + step[1] ** 2), 0), 1);
    const far = Math.hypot(from[0] - share * step[0], from[1] - share * step[1]);
    if (far < best.far) best = {far, share: axis[k - 1] + share * (axis[k] - axis[k - 1])};
  }
  return best;
}

/** Turns and reflections of wavevectors, as matrices on their fractions, that keep the frequencies at one without symmetry. */
function symmetries(data, state) {
  const digits = data.periods === 2 ? [-1, 0, 1] : [0], K = bondMatrices(data, state, 'complete');
  const at = q => hermitian(blochMatrix(data, state, K, q)).values, length = q => Math.hypot(...wavevector(data, q));
  const drawn = [0.137, data.periods === 2 ? 0.291 : 0], expected = at(drawn), found = [];
  const every = (list, size) => size === 0 ? [[]] : every(list, size - 1).flatMap(row => list.map(value => [...row, value]));
  for (const [a, b, c, d] of data.periods === 2 ? every(digits, 4) : [[1, 0, 0, 1], [-1, 0, 0, 1]]) {
    const turn = [[a, b], [c, d]], image = q => turn.map(([x, y]) => x * q[0] + y * q[1]);
    if (Math.abs(a * d - b * c) !== 1) continue;
    const values = Math.abs(length(image(drawn)) / length(drawn) - 1) < 1e-6 ? at(image(drawn)) : null;
    const top = expected[expected.length - 1];
    if (values?.every((value, k) => Math.abs(value - expected[k]) < 1e-9 * top)) found.push(turn);
  }
  return found;
}
