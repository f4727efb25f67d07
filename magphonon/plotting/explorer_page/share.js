// What leaves the page: a link with its state, and its scene.
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
  const b_N_m_a = data.law.kind === 'power' && data.law.force_N * data.law.spacing_m ** state.exponent;
  return Object.entries({...state, b_N_m_a}).reduce((text, [key, value]) => text.replaceAll(`"{${key}}"`, String(value)),
    data.template);
}
