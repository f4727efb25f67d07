// The page: sliders, words, and what follows from them.
'use strict';

const data = JSON.parse(document.getElementById('data').textContent);
const element = id => document.getElementById(id);
const NAMES = Object.keys(data.sliders);
const KEYS = {spacing: 'spacing_m', exponent: 'exponent', foundation: 'foundation_N_per_m'};
const TRANSVERSE = data.periods === 1 ? 'transverse' : 'shear';
const HIGHEST_SHOWN_Hz = 1.5;  // frequency at which the highest mode moves on the screen

const NO_EXPONENT = `<p class="why">There is no slider for the exponent, because the law of this scene is no inverse power
  <i>b r</i><sup>\u2212<i>a</i></sup>.</p>`;

const scene = stateAt(Object.fromEntries(NAMES.map(name => [name, data.sliders[name].scene])));
const sceneBands = bandsOf(data, scene, 'complete');
const view = {state: scene, bands: null, chosen: {model: 'complete', branch: 0, at: data.path.point.at}, slowed: 1,
  playing: !matchMedia('(prefers-reduced-motion: reduce)').matches};
const motion = new Motion(element('lattice'), data);

function stateAt(positions) {
  const state = {positions, spacing_index: positions.spacing};
  for (const name of NAMES) state[KEYS[name]] = data.sliders[name].values[positions[name]];
  return state;
}

/** The value of a slider as it is read, with its unit. */
function shown(name, value, digits = 6) {
  const {unit, per_SI} = data.sliders[name];
  return `${written(value * per_SI, digits)}${unit && '\u202f' + unit}`;
}

function update() {
  view.state = stateAt(Object.fromEntries(NAMES.map(name => [name, Number(element(name).value)])));
  view.bands = {complete: bandsOf(data, view.state, 'complete'), conventional: bandsOf(data, view.state, 'conventional')};
  const moved = NAMES.some(name => view.state.positions[name] !== scene.positions[name]);
  if (moved) view.bands.scene = sceneBands;
  document.querySelector('#legend .scene').style.visibility = moved ? 'visible' : 'hidden';
  element('reset').disabled = !moved;
  for (const name of NAMES) showSlider(name);
  tellStability();
  tellDstar();
  showMode();
}

function showSlider(name) {
  const {values, scene: reference} = data.sliders[name];
  const value = shown(name, view.state[KEYS[name]]);
  element(`${name}-value`).textContent = value;
  element(name).setAttribute('aria-valuetext', value);
  const ranges = bucklingRanges(data, view.state, KEYS[name], values);
  const place = v => 100 * positionOf(values, v) / (values.length - 1);
  const marks = ranges.flatMap(([from, to]) => {
    const [left, right] = [from === null ? 0 : place(from), to === null ? 100 : place(to)];
    return [`<span class="buckling" style="left:${left}%;width:${right - left}%"></span>`,
      ...[from, to].filter(v => v !== null).map(v => `<span class="border" style="left:${place(v)}%"></span>`)];
  });
  marks.push(`<span class="reference" style="left:${place(values[reference])}%">&#9650;</span>`);
  element(`${name}-scale`).innerHTML = marks.join('');
  element(`${name}-border`).textContent = rangesInWords(name, ranges);
}

/** The place of a value among the values of a slider, counted from 0, between two of them too. */
function positionOf(values, value) {
  return interpolated(values, values.map((_, k) => k), value);
}

function rangesInWords(name, ranges) {
  if (!ranges.length) return 'buckles nowhere on this slider';
  const {values} = data.sliders[name], last = values[values.length - 1];
  const digits = Math.max(4, Math.ceil(Math.log10(last * values.length / (last - values[0]))));  // to a step of the slider
  return 'buckles ' + ranges.map(([from, to]) => {
    if (from === null && to === null) return 'everywhere on this slider';
    if (from === null) return `below ${shown(name, to, digits)}`;
    return to === null ? `above ${shown(name, from, digits)}` : `from ${shown(name, from, digits)} to ${shown(name, to, digits)}`;
  }).join(' and ');
}

function tellStability() {
  const needed = neededFoundation(data, view.state), has = view.state.foundation_N_per_m;
  const unstable = needed > has;
  document.body.classList.toggle('buckles', unstable);
  if (!unstable) {
    element('stability').innerHTML = '<strong>Stable.</strong> ' + (needed === 0 ? 'The lattice holds without a foundation.'
      : `The lattice needs a foundation of ${written(needed)}\u202fN/m; it has ${written(has)}\u202fN/m.`);
    return;
  }
  const lowest = Math.min(...view.bands.complete.flat());
  const shownHere = lowest < -NEGLIGIBLE * Math.max(...view.bands.complete.flat());
  const where = shownHere
    ? `The lowest squared frequency of the complete model is \u2212(${written(-2 * Math.PI * lowest)}\u202frad/s)\u00b2.`
    : 'The mode that grows lies beside this path.';
  element('stability').innerHTML = `<strong>Buckles.</strong> The lattice needs a foundation of ${written(needed)}\u202fN/m and
    has only ${written(has)}\u202fN/m. ${where} The conventional model does not show it.`;
}

/** What D* does to the lowest branch at one special point. */
function effectOfDstar() {
  const {at, name} = data.path.point;
  const [complete, conventional] = [view.bands.complete[at][0], view.bands.conventional[at][0]];
  const mode = modeOf(data, view.state, 'complete', data.path.q[at], 0);
  const branch = motionName(mode, data.path.q[at]) === TRANSVERSE ? `${TRANSVERSE} branch` : 'lowest branch';
  return {name, complete, conventional, branch, ratio: complete / conventional};
}

function tellDstar() {
  const {name, complete, conventional, branch, ratio} = effectOfDstar();
  const start = `At ${name}, <strong>D*</strong> `;
  if (complete < -NEGLIGIBLE * Math.max(...view.bands.conventional.flat())) {
    element('dstar').innerHTML = `${start}makes the ${branch} unstable: it ${growth(complete)}. The conventional model has
      ${written(conventional)}\u202fHz there.`;
  } else {
    element('dstar').innerHTML = `${start}lowers the ${branch} from ${written(conventional)}\u202fHz to
      ${written(complete)}\u202fHz, by ${written(100 * (1 - ratio), 3)}\u202f%: the ratio complete/conventional is
      ${written(ratio)}.`;
  }
}

/** How fast a mode of negative frequency grows. */
function growth(frequency) {
  const time_s = 1 / (2 * Math.PI * -frequency);
  return `grows e-fold in ${time_s < 1 ? `${written(1000 * time_s)}\u202fms` : `${written(time_s)}\u202fs`}`;
}

/** The name of a motion of which nine tenths of the energy move across or along the wavevector. */
function motionName(mode, q) {
  const k = wavevector(data, q), length = Math.hypot(...k);
  if (length < 1e-12) return '';
  let [along, all] = [0, 0];
  mode.shape.forEach(([ux, uy], j) => {
    const part = [0, 1].map(c => (ux[c] * k[0] + uy[c] * k[1]) / length);
    along += data.masses_kg[j] * (part[0] ** 2 + part[1] ** 2);
    all += data.masses_kg[j] * (ux[0] ** 2 + ux[1] ** 2 + uy[0] ** 2 + uy[1] ** 2);
  });
  return along > 0.9 * all ? 'longitudinal' : along < 0.1 * all ? TRANSVERSE : 'mixed';
}

function showMode() {
  const {model, branch, at} = view.chosen;
  const q = data.path.q[at], mode = modeOf(data, view.state, model, q, branch);
  const name = motionName(mode, q), effect = effectOfDstar();
  // a steep branch runs beside an unstable mode, and a longer label would lie on it
  const label = effect.complete < 0 ? 'D*' : `D*: \u2212${written(100 * (1 - effect.ratio), 2)}\u202f%`;
  drawBands(element('bands'), data, view.bands, view.chosen, {...effect, label});
  const where = data.path.named[at] ?? `q = (${q.slice(0, data.periods).map(part => written(part, 3)).join(', ')})`;
  const speed = mode.frequency_Hz < 0 ? growth(mode.frequency_Hz) : `${written(mode.frequency_Hz)}\u202fHz`;
  element('mode').innerHTML = `<b>${model}</b>, branch ${branch + 1} at ${where}: <b>${speed}</b>${name && `, ${name}`}`;
  view.slowed = roundStep(Math.max(...view.bands.conventional.flat()) / HIGHEST_SHOWN_Hz);
  motion.show(mode, q, model);
  showPlaying();
}

function showPlaying() {
  element('play').textContent = view.playing ? 'Pause' : 'Play';
  const times = view.slowed >= 1 ? `${written(view.slowed)} times slower` : `${written(1 / view.slowed)} times faster`;
  element('tempo').textContent = `${times} than the lattice; small displacements, drawn large.`;
}

function choose(mode) {
  view.chosen = mode;
  showMode();
}

/** The next mode in a direction: among the wavevectors, or among the branches of both models by frequency. */
function neighbour({model, branch, at}, sideways, upwards) {
  if (sideways) return {model, branch, at: Math.min(Math.max(at + sideways, 0), data.path.q.length - 1)};
  const all = ['complete', 'conventional'].flatMap(name => view.bands[name][at].map((f, k) => ({model: name, branch: k, at, f})));
  all.sort((one, other) => one.f - other.f);
  const now = all.findIndex(mode => mode.model === model && mode.branch === branch);
  const {f, ...next} = all[Math.min(Math.max(now + upwards, 0), all.length - 1)];
  return next;
}

function listen() {
  for (const name of NAMES) element(name).addEventListener('input', update);
  element('reset').addEventListener('click', () => {
    for (const name of NAMES) element(name).value = data.sliders[name].scene;
    update();
  });
  element('play').addEventListener('click', () => {
    view.playing = !view.playing;
    showPlaying();
  });
  const chart = element('bands');
  const choosePointed = event => {
    const box = chart.getBoundingClientRect();
    choose(nearestMode(chart, data, view.bands, event.clientX - box.left, event.clientY - box.top));
  };
  chart.addEventListener('pointerdown', choosePointed);
  chart.addEventListener('pointermove', event => event.buttons && choosePointed(event));
  const steps = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};
  chart.addEventListener('keydown', event => {
    if (!(event.key in steps)) return;
    event.preventDefault();
    choose(neighbour(view.chosen, ...steps[event.key]));
  });
  new ResizeObserver(() => {
    motion.layOut();
    showMode();
  }).observe(document.querySelector('main'));
}

function start() {
  for (const name of NAMES) {
    const {values, scene: value} = data.sliders[name];
    Object.assign(element(name), {min: 0, max: values.length - 1, value});
  }
  if (!data.sliders.exponent) element('exponent').closest('.slider').innerHTML = NO_EXPONENT;
  else element('law').textContent = `the force at ${shown('spacing', scene.spacing_m)} stays ${written(data.law.force_N)}\u202fN`;
  listen();
  update();
  let last = performance.now();
  const frame = now => {
    if (view.playing) motion.advance(Math.min(now - last, 100) / 1000 / view.slowed);
    last = now;
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
}

start();
