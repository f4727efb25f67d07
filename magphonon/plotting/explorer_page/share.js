// What leaves the page: a link with its state, its scene, its picture.
'use strict';

/** The state as it stands in the address: sliders that were moved, in their own units, and the mode. */
function linkOf(state, chosen) {
  const told = new URLSearchParams();
  for (const name of NAMES) {
    const {values, scene: reference, per_SI} = data.sliders[name], place = state.positions[name];
    if (place !== reference) told.set(name, written(values[place] * per_SI, 9));
  }
  if (chosen.at !== data.path.point.at) told.set('point', chosen.at);
  if (chosen.branch) told.set('branch', chosen.branch + 1);
  for (const name of ['view', 'source', ...Object.keys(TOLD)]) if (address.has(name)) told.set(name, address.get(name));
  return `#${told}`.replace('\u2212', '-');
}

/** Sliders and mode as an address tells them, the nearest that there are; what it leaves out is as in the scene. */
function stateOfLink(hash) {
  const told = new URLSearchParams(hash.slice(1)), positions = {};
  const whole = (name, most, otherwise) => Math.min(Math.max(Math.round(told.get(name) ?? otherwise) || 0, 0), most);
  for (const name of NAMES) {
    const {values, scene: reference, per_SI} = data.sliders[name], asked = parseFloat(told.get(name)) / per_SI;
    const far = values.map(value => Math.abs(value - asked));
    positions[name] = Number.isFinite(asked) ? far.indexOf(Math.min(...far)) : reference;
  }
  const at = whole('point', data.path.q.length - 1, data.path.point.at);
  return {positions, chosen: {at, branch: Math.max(whole('branch', 2 * data.masses_kg.length, 1), 1) - 1}};
}

/** The scene with the values of the sliders in place of their names. */
function sceneText(state) {
  const force = data.law.kind === 'power' && data.law.force_N * (state.spacing_m / data.law.spacing_m) ** -state.exponent;
  return Object.entries({...state, force_N: force}).reduce((text, [key, value]) => text.replaceAll(`"{${key}}"`, String(value)),
    data.template);
}

/** The chart with its title, values and legend, as an address that holds the picture in PNG. */
async function pictureOf(chart, title, values) {
  const [width, height, head] = [chart.clientWidth, chart.clientHeight, 78];
  const inner = chart.cloneNode(true);
  Object.entries({y: head, width, height}).forEach(([name, value]) => inner.setAttribute(name, value));
  const whole = document.createElementNS(chart.namespaceURI, 'svg');
  Object.entries({width, height: height + head}).forEach(([name, value]) => whole.setAttribute(name, value));
  if (document.documentElement.classList.contains('dark')) whole.classList.add('dark');
  whole.innerHTML = `<rect width="100%" height="100%" fill="var(--paper)"/><text class="bold" x="12" y="22"></text>
    <text x="12" y="43"></text><path class="complete" d="M12 62h30"/><text x="48" y="67">with D*</text>
    <path class="conventional" d="M122 62h30"/><text x="158" y="67">without D*</text>`;
  const style = document.createElementNS(chart.namespaceURI, 'style');
  style.textContent = `${document.querySelector('style').textContent}
    text { font-family: system-ui, sans-serif } .bold { font-weight: 650 }`;
  whole.prepend(style);
  [...whole.querySelectorAll('text')].slice(0, 2).forEach((text, k) => { text.textContent = [title, values][k]; });
  whole.append(inner);
  const image = new Image();
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(new XMLSerializer().serializeToString(whole))}`;
  await image.decode();
  const canvas = document.createElement('canvas');
  Object.assign(canvas, {width: 2 * width, height: 2 * (height + head)});
  canvas.getContext('2d').drawImage(image, 0, 0, canvas.width, canvas.height);
  return canvas.toDataURL('image/png');
}

/** One second of each frequency, in Hz, one after the other. */
function sound(frequencies) {
  const context = new AudioContext(), volume = context.createGain();
  volume.gain.value = 0.3;
  volume.connect(context.destination);
  frequencies.forEach((frequency, k) => {
    const tone = Object.assign(context.createOscillator(), {type: 'triangle'});
    tone.frequency.value = frequency;
    tone.connect(volume);
    tone.start(context.currentTime + 1.2 * k);
    tone.stop(context.currentTime + 1.2 * k + 1);
  });
}
