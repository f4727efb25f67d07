// The band diagram, as SVG.
const MARGIN = {left: 66, right: 30, top: 10, bottom: 28};
const NEGLIGIBLE = 1e-6;  // of the highest frequency: the square root of a rounded eigenvalue

/** How a wavevector of the path and a frequency become places in a picture of the given size. */
function scalesOf(svg, data, bands) {
  const [width, height] = [svg.clientWidth, svg.clientHeight];
  const every = [bands.complete, bands.conventional].flat(2);
  const [highest, lowest] = [Math.max(...every), Math.min(...every)];
  const step = roundStep((highest - Math.min(lowest, 0)) / 8);
  const top = step * Math.ceil(1.02 * highest / step);
  const bottom = lowest < -NEGLIGIBLE * highest ? step * Math.floor(1.02 * lowest / step) : 0;
  const [right, under] = [width - MARGIN.right, height - MARGIN.bottom];
  return {
    width, height, right, under, top, bottom, step,
    x: k => MARGIN.left + data.path.axis[k] * (right - MARGIN.left),
    y: f => MARGIN.top + (top - f) / (top - bottom) * (under - MARGIN.top),
  };
}

/** The next larger one of 1, 2, 5, 10, ... */
function roundStep(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [1, 2, 5, 10].find(digit => digit * power >= value * (1 - 1e-9));
}

function drawBands(svg, data, bands, chosen, effect) {
  if (!svg.clientWidth) return;  // not laid out yet: the page draws again when it is
  const scales = scalesOf(svg, data, bands);
  const {x, y} = scales;
  const marks = ['conventional', 'complete'].map(model => `<circle class="chosen ${model}" r="6" cx="${x(chosen.at)}"
    cy="${y(bands[model][chosen.at][chosen.branch])}"/>`);
  svg.innerHTML = frame(data, scales)
    + `<clipPath id="inside"><rect x="${MARGIN.left}" y="${MARGIN.top}" width="${scales.right - MARGIN.left}"
      height="${scales.under - MARGIN.top}"/></clipPath>`
    + (bands.scene ? `<g clip-path="url(#inside)">${branches(data, scales, bands.scene, 'scene')}</g>` : '')
    + branches(data, scales, bands.complete, 'complete') + branches(data, scales, bands.conventional, 'conventional')
    + arrow(scales, data, effect) + marks.join('');
}

/** Axes, grid, and the region of unstable modes. */
function frame(data, {right, under, top, bottom, step, x, y, height}) {
  const parts = [`<pattern id="stripes" width="7" height="7" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">
    <line class="stripes" x1="0" y1="0" x2="0" y2="7"/></pattern>`];
  if (bottom < 0) {
    parts.push(`<rect class="unstable" x="${MARGIN.left}" y="${y(0)}" width="${right - MARGIN.left}" height="${under - y(0)}"/>`,
      upright('imaginary', right + 22, (y(0) + under) / 2));
  }
  for (let f = bottom; f < top + step / 2; f += step) {
    parts.push(`<line class="grid" x1="${MARGIN.left}" x2="${right}" y1="${y(f)}" y2="${y(f)}"/>`,
      `<text x="${MARGIN.left - 8}" y="${y(f) + 5}" text-anchor="end">${written(Math.abs(f))}${f < -step / 2 ? 'i' : ''}</text>`);
  }
  for (const {at, name} of data.path.ticks) {
    parts.push(`<line class="grid" x1="${x(at)}" x2="${x(at)}" y1="${MARGIN.top}" y2="${under}"/>`,
      `<text x="${x(at)}" y="${height - 8}" text-anchor="middle">${name}</text>`);
  }
  parts.push(`<path class="axis" d="M${MARGIN.left} ${MARGIN.top}V${under}H${right}"/>`,
    `<line class="axis" x1="${MARGIN.left}" x2="${right}" y1="${y(0)}" y2="${y(0)}"/>`,
    upright('frequency (Hz)', 13, (MARGIN.top + under) / 2));
  return parts.join('');
}

function upright(words, x, y) {
  return `<text class="title" transform="translate(${x} ${y}) rotate(-90)" text-anchor="middle">${words}</text>`;
}

/** One path for each branch, with a gap where the path through the zone jumps. */
function branches(data, {x, y}, bands, look) {
  return bands[0].map((_, branch) => {
    const begins = k => k === 0 || data.path.jumps.includes(k);
    const place = (at, f) => `${at.toFixed(3)} ${y(f).toFixed(3)}`;
    const points = bands.map((row, k) => {
      if (begins(k)) return `M${place(x(k), row[branch])}`;
      const [before, now] = [bands[k - 1][branch], row[branch]];
      // where a branch becomes unstable its square goes straight through zero, and its root does not
      const steps = before < 0 === now < 0 ? [1] : [1, 2, 3, 4, 5, 6].map(step => step / 6);
      return steps.map(s => `L${place(x(k - 1) + s * (x(k) - x(k - 1)), between(before, now, s))}`).join('');
    });
    return `<path class="${look}" data-branch="${branch}" d="${points.join('')}"/>`;
  }).join('');
}

function between(before, now, share) {
  if (share === 1) return now;
  const square = (1 - share) * before * Math.abs(before) + share * now * Math.abs(now);
  return Math.sign(square) * Math.sqrt(Math.abs(square));
}

/** What D* does at one special point: an arrow from the conventional to the complete model. */
function arrow({x, y}, data, {conventional, complete, label}) {
  const [at, from, to] = [x(data.path.point.at), y(conventional), y(complete)];
  if (to - from < 14) return '';
  const [anchor, aside] = at > MARGIN.left + 110 ? ['end', -9] : ['start', 9];  // a label is about 100 pixels wide
  const height = from + 0.62 * (to - from);
  return `<path class="effect" d="M${at} ${from}V${to - 8}"/><path class="effect-head" d="M${at} ${to - 2}l-5 -10h10z"/>
    <text class="effect-label" text-anchor="${anchor}" x="${at + aside}" y="${height}">${label}</text>`;
}

/** The wavevector and branch of the mode, of either model, nearest to a place in the picture. */
function nearestMode(svg, data, bands, left, top) {
  const {x, y} = scalesOf(svg, data, bands);
  let best = null;
  data.path.axis.forEach((_, at) => {
    for (const model of ['complete', 'conventional']) {
      bands[model][at].forEach((f, branch) => {
        const far = Math.hypot(x(at) - left, y(f) - top);
        if (best === null || far < best.far) best = {branch, at, far};
      });
    }
  });
  return {branch: best.branch, at: best.at};
}

/** A number with four digits, or as many as are asked for. */
function written(value, digits = 4) {
  return String(Number(value.toPrecision(digits))).replace('-', '\u2212');
}
