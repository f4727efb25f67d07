// The page: sliders, words, and what follows from them.
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
const view = {state: scene, bands: null, chosen: {branch: 0, at: data.path.point.at}, slowed: 1,
  playing: !matchMedia('(prefers-reduced-motion: reduce)').matches};
const system = matchMedia('(prefers-color-scheme: dark)');
const MODELS = ['complete', 'conventional'];
const address = new URLSearchParams(location.hash.slice(1));  // what it tells of the burst is kept
const motions = Object.fromEntries(MODELS.map(model => [model, new Motion(element(`lattice-${model}`), data)]));

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
  const unstable = Math.min(...view.bands.complete.flat()) < -NEGLIGIBLE * Math.max(...view.bands.complete.flat());
  document.body.classList.toggle('buckles', buckles(data, view.state));
  element('stability').innerHTML = stabilityInWords(view.state, !unstable);
  element('dstar').innerHTML = dstarInWords(effectOfDstar(view.state));
  showMode();
  view.burst?.follow(view.state);
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
  if (!ranges.length) return 'stable everywhere';
  const {values} = data.sliders[name], last = values[values.length - 1];
  const digits = Math.max(4, Math.ceil(Math.log10(last * values.length / (last - values[0]))));  // to a step of the slider
  return 'buckles ' + ranges.map(([from, to]) => {
    if (from === null && to === null) return 'everywhere';
    if (from === null) return `below ${shown(name, to, digits)}`;
    return to === null ? `above ${shown(name, from, digits)}` : `from ${shown(name, from, digits)} to ${shown(name, to, digits)}`;
  }).join(' and ');
}

/** Whether the lattice holds; `beside` if the mode that grows is not on the path of the chart. */
function stabilityInWords(state, beside) {
  const [needed, has] = [neededFoundation(data, state), state.foundation_N_per_m];
  const both = `The lattice needs a foundation of ${written(needed)}\u202fN/m; it has ${written(has)}\u202fN/m.`;
  if (!buckles(data, state)) return `<strong>Stable.</strong> ${needed === 0 ? 'The lattice holds without a foundation.' : both}`;
  return `<strong>Buckles.</strong> ${both} `
    + (beside ? 'The growing mode lies off this path.' : 'The conventional model does not show it.');
}

/** What D* does to the lowest branch at one special point. */
function effectOfDstar(state) {
  const {at, name} = data.path.point, q = data.path.q[at];
  const [mode, other] = MODELS.map(model => modeOf(data, state, model, q, 0));
  const branch = motionName(mode, q) === TRANSVERSE ? `${TRANSVERSE} branch` : 'lowest branch';
  const [complete, conventional] = [mode.frequency_Hz, other.frequency_Hz];
  return {name, complete, conventional, branch, ratio: complete / conventional};
}

function dstarInWords({name, complete, conventional, branch, ratio}) {
  const start = `At ${name}, <strong>D*</strong> `;
  if (complete < -NEGLIGIBLE * conventional) {
    return `${start}makes the ${branch} unstable: it ${growth(complete)}. The conventional model `
      + `has ${written(conventional)}\u202fHz there.`;
  }
  return `${start}lowers the ${branch} from ${written(conventional)}\u202fHz to ${written(complete)}\u202fHz, `
    + `by ${written(100 * (1 - ratio), 3)}\u202f%.`;
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
  const {branch, at} = view.chosen, q = data.path.q[at], effect = effectOfDstar(view.state);
  // a steep branch runs beside an unstable mode, and a longer label would lie on it
  const label = effect.complete < 0 ? 'D*' : `D*: \u2212${written(100 * (1 - effect.ratio), 2)}\u202f%`;
  drawBands(element('bands'), data, view.bands, view.chosen, {...effect, label});
  const where = data.path.named[at] ?? `q = (${q.slice(0, data.periods).map(part => written(part, 3)).join(', ')})`;
  element('mode').innerHTML = `<b>Branch ${branch + 1}</b> at ${where}`;
  view.slowed = roundStep(Math.max(...view.bands.conventional.flat()) / HIGHEST_SHOWN_Hz);
  for (const model of MODELS) {
    const mode = modeOf(data, view.state, model, q, branch), name = motionName(mode, q), f = mode.frequency_Hz;
    element(`mode-${model}`).innerHTML = `<b>${f < 0 ? growth(f) : `${written(f)}\u202fHz`}</b>${name && `, ${name}`}`;
    motions[model].show(mode, q);
  }
  showPlaying();
  writeLink();
}

function writeLink() {
  clearTimeout(view.linking);  // browsers refuse hundreds of addresses in a few seconds
  view.linking = setTimeout(() => history.replaceState(null, '', linkOf(view.state, view.chosen)), 300);
}

function showPlaying() {
  element('play').textContent = view.playing ? 'Pause' : 'Play';
  element('tempo').textContent = `${inWords(view.slowed)}; displacements are drawn larger`;
}

function inWords(slowed) {
  return slowed >= 1 ? `${written(slowed)} times slower` : `${written(1 / slowed)} times faster`;
}

function choose(mode) {
  view.chosen = mode;
  showMode();
}

/** The next mode in a direction: among the wavevectors, or among the branches. */
function neighbour({branch, at}, sideways, upwards) {
  const within = (value, length) => Math.min(Math.max(value, 0), length - 1);
  return {branch: within(branch + upwards, view.bands.complete[at].length), at: within(at + sideways, data.path.q.length)};
}

/** Go to the state that an address tells. */
function followLink() {
  const {positions, chosen} = stateOfLink(location.hash);
  for (const name of NAMES) element(name).value = positions[name];
  view.chosen = chosen;
  update();
}

/** Put the scene on the clipboard, and say so; where this is not allowed, show it at the end of the page. */
async function copyScene() {
  const text = sceneText(view.state);
  try {
    await navigator.clipboard.writeText(text);
    element('told').textContent = 'The scene is copied; paste it into a file of your own.';
  } catch {
    element('text').textContent = text;
    element('text').closest('details').open = true;
    element('told').textContent = 'This browser does not allow copying: the text is at the end of the page.';
  }
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
  element('copy').addEventListener('click', copyScene);
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
  addEventListener('hashchange', followLink);
  new ResizeObserver(() => {
    Object.values(motions).forEach(motion => motion.layOut());
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
  document.body.classList.toggle('chain', data.periods === 1);
  document.body.classList.toggle('structure', Boolean(data.structure));
  document.body.classList.toggle('only-burst', Boolean(data.structure) || address.get('view') === 'burst');
  document.body.classList.toggle('only-bands', address.get('view') === 'bands');
  document.body.classList.toggle('framed', parent !== window);
  if (document.body.classList.contains('only-burst')) element('burst').after(document.querySelector('main'));
  if (!data.structure) {
    listen();
    followLink();
  }
  if (data.periods !== 1 && address.get('view') !== 'bands') view.burst = new BurstView(element('burst'), data, view.state, address);
  let last = performance.now();
  const frame = now => {
    view.burst?.frame((now - last) / 1000);
    if (view.playing && !data.structure) Object.values(motions).forEach(motion => motion.advance(Math.min(now - last, 100) / 1000 / view.slowed));
    last = now;
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
}

/** Dark or light as the page that frames this one says, otherwise as the system is. */
function colour() {
  document.documentElement.classList.toggle('dark', view.theme === 'dark' || (view.theme !== 'light' && system.matches));
  view.burst?.draw();
}

/** A frame that holds this page is as high as the page. */
function tellHeight() {
  if (parent !== window) parent.postMessage({magphononHeight: document.body.offsetHeight}, '*');
}

colour();
system.addEventListener('change', colour);
addEventListener('message', ({data, source}) => {
  if (source !== parent || !data?.magphononTheme) return;
  view.theme = data.magphononTheme;
  colour();
});
start();
new ResizeObserver(tellHeight).observe(document.body);
