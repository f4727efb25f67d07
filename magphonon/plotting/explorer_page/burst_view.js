// The burst as it is seen and played with: two patches side by side on one scale of colours.
const LEVELS = 24;  // shades on either side of rest
const BRIGHTEST = 0.6;  // of the largest displacement, from which a colour is full
const CYCLES = 5;
const FORCE_N = 2.5e-4;  // linear waves: it sets no picture, only the largest displacement that is told
const STILL = 7;  // periods after which the waves are shown that stand still
const LIMIT = 30;  // times the largest displacement under the push, from which a lattice that buckles is stopped
const PERIOD_s = 0.5;  // of the carrier on the screen at first
const TOLD = {carrier: 'carrier_Hz', damping: 'damping_per_s', gyration: 'gyration_rad_per_s', cycles: 'cycles'};

class BurstView {
  /** `state` tells where the sliders of the page are; `told` what the address says of carrier, damping, gyration, cycles, source. */
  constructor(root, data, state, told) {
    Object.assign(this, {root, data, state, address: told, gone: new Set(), tool: 'push', cursor: null});
    this.canvases = Object.fromEntries(MODELS.map(model => [model, root.querySelector(`canvas.${model}`)]));
    const {source = null, highest_Hz: highest, ...drive} = data.structure?.drive ?? driveOf(data, state);
    this.drive = {force_N: FORCE_N, gyration_rad_per_s: 0, ...drive};
    this.source = source;
    for (const [name, key] of Object.entries(TOLD)) {
      const given = parseFloat(told.get(name));
      if (given >= 0) this.drive[key] = given;
    }
    const most = {carrier: 1.1 * highest, damping: 20 * drive.damping_per_s, gyration: 2 * Math.PI * highest};
    for (const name of Object.keys(most)) {
      const input = root.querySelector(`[name=${name}]`), step = roundStep(Math.max(most[name], 1.5 * this.drive[TOLD[name]]) / 1000);
      Object.assign(input, {min: name === 'carrier' ? step : 0, max: 1200 * step, step, value: this.drive[TOLD[name]]});
      input.addEventListener('input', () => { this.address.set(name, input.value); this.restart(); writeLink(); });
    }
    this.slower = roundStep((data.structure ? 0.4 : 1) * PERIOD_s * this.drive.carrier_Hz);
    root.querySelector('[name=slower]').innerHTML = [0.4, 1, 4].map(times => `<option value="${times * this.slower}"${
      times === 1 ? ' selected' : ''}>${inWords(times * this.slower)}</option>`).join('');
    this.rim = told.get('source') === 'rim';
    this.rebuild();
    this.listen();
  }

  /** The patch without the particles that were removed, at rest; false, and as before, if it buckles. */
  rebuild() {
    const patch = patchOf(this.data, this.gone);
    this.rest = patch.relaxed ? null : relaxed(patch, this.data, this.state);
    if (!patch.relaxed && !this.rest) return false;
    this.patch = patch;
    const at = patch.keys.indexOf(this.source);
    if (at < 0 || patch.held[at]) this.source = patch.keys[this.first()];
    this.restart();
    return true;
  }

  /** The free particle in the middle, or in the middle of the lower rim. */
  first() {
    const {x, y, held} = this.patch, low = Math.min(...y.filter((_, p) => !held[p]));
    const far = x.map((_, p) => held[p] ? Infinity : Math.hypot(x[p], this.rim ? 10 * (y[p] - low) : y[p]));
    return far.indexOf(Math.min(...far));
  }

  /** Both lattices at rest again, with the sliders where they are. */
  restart() {
    for (const name of ['carrier', 'damping', 'gyration']) {
      const input = this.root.querySelector(`[name=${name}]`), unit = {carrier: 'Hz', damping: 's\u207b\u00b9', gyration: 'rad/s'}[name];
      this.drive[TOLD[name]] = Number(input.value);
      input.closest('label').querySelector('output').textContent = `${written(this.drive[TOLD[name]], 4)}\u202f${unit}`;
    }
    this.drive.source = this.patch.keys.indexOf(this.source);
    const bonds = bondsAt(this.patch, this.data, this.state, this.rest);
    const each = make => Object.fromEntries(MODELS.map(model => [model, make(model)])), springs = springsOf(this.patch, this.state);
    this.bursts = each(model => new Burst(this.patch, bonds, model, springs, this.drive));
    this.pushed = each(() => 0);
    this.draw();
  }

  /** Let a time in s pass in both lattices. */
  advance(time) {
    for (const model of MODELS) {
      const burst = this.bursts[model];
      if (burst.grown) continue;
      burst.advance(time);
      const largest = burst.u.reduce((most, u) => Math.max(most, Math.abs(u)), 0);
      if (burst.t < this.drive.cycles / this.drive.carrier_Hz) this.pushed[model] = Math.max(this.pushed[model], largest);
      burst.grown = largest > LIMIT * this.pushed[model] && this.pushed[model] > 0;
    }
    this.draw();
  }

  /** When the patch is as full of echoes as it gets: six bursts after the push; of a structure, when the tone ends. */
  get over() {
    return this.bursts.complete.t > (this.patch.springs ? 1 : 6) * this.drive.cycles / this.drive.carrier_Hz;
  }

  /** Pixels per spacing of a canvas, and half the height of the patch in spacings. */
  scaleOf(canvas) {
    const [wide, high] = [this.patch.x, this.patch.y].map(places => Math.max(...places.map(Math.abs)) + 0.6);
    return {unit: canvas.clientWidth / 2 / wide, high};
  }

  draw() {
    const {x, y, held, size} = this.patch, dark = document.documentElement.classList.contains('dark');
    const free = MODELS.filter(model => !this.bursts[model].grown).flatMap(model => this.along(this.bursts[model].u));
    const scale = BRIGHTEST * free.reduce((most, u) => Math.max(most, Math.abs(u)), 1e-300);
    for (const model of MODELS) {
      const canvas = this.canvases[model], width = canvas.clientWidth, dense = devicePixelRatio || 1, burst = this.bursts[model];
      const {unit, high} = this.scaleOf(canvas);
      canvas.style.height = `${2 * high * unit}px`;
      if (canvas.width !== Math.round(width * dense)) canvas.width = Math.round(width * dense);
      if (canvas.height !== Math.round(2 * high * unit * dense)) canvas.height = Math.round(2 * high * unit * dense);
      const pen = canvas.getContext('2d');
      pen.setTransform(dense, 0, 0, dense, 0, 0);
      pen.clearRect(0, 0, width, 2 * high * unit);
      const shades = new Map(), moved = this.along(burst.u);
      for (let p = 0; p < size; p++) {
        const level = held[p] ? 'held' : Math.round(LEVELS * Math.max(-1, Math.min(1, moved[p] / scale)));
        if (!shades.has(level)) shades.set(level, []);
        shades.get(level).push(p);
      }
      const place = p => [width / 2 + unit * x[p], (high - y[p]) * unit], dot = 0.42 * unit;
      for (const [level, particles] of shades) {
        pen.fillStyle = level === 'held' ? (dark ? '#6c747e' : '#9aa1aa') : shade(level / LEVELS, dark);
        pen.beginPath();
        for (const p of particles) {
          const [px, py] = place(p);
          pen.moveTo(px + dot, py);
          pen.arc(px, py, dot, 0, 2 * Math.PI);
        }
        pen.fill();
      }
      pen.lineWidth = 2;
      pen.strokeStyle = dark ? '#fff' : '#000';
      for (const p of [this.drive.source, ...(this.cursor === null ? [] : [this.cursor])]) {
        pen.beginPath();
        pen.arc(...place(p), p === this.cursor ? 1.6 * dot : dot, 0, 2 * Math.PI);
        pen.stroke();
      }
      canvas.dataset.time_ms = 1e3 * burst.t;
      this.root.querySelector(`.${model} .told`).textContent = burst.grown ? 'it buckles: the motion grows without bound'
        : `${(1e3 * burst.t).toFixed(0)}\u202fms`;
    }
  }

  /** Displacements along the push. */
  along(u) {
    const [dx, dy] = this.drive.direction;
    return this.patch.keys.map((_, p) => dx * u[2 * p] + dy * u[2 * p + 1]);
  }

  /** The particle nearest to a point of a canvas, in pixels. */
  nearest(canvas, px, py) {
    const {x, y} = this.patch, width = canvas.clientWidth, height = canvas.clientHeight, {unit} = this.scaleOf(canvas);
    const far = x.map((_, p) => Math.hypot(width / 2 + unit * x[p] - px, height / 2 - unit * y[p] - py));
    return far.indexOf(Math.min(...far));
  }

  /** Push a particle, or take it out; where one was taken out, put it back. */
  act(p, place) {
    if (this.tool === 'push') {
      if (this.patch.held[p]) return this.tell('The rim is held; push a particle inside it.');
      this.source = this.patch.keys[p];
      this.restart();
      return this.tell('');
    }
    const back = place && [...this.gone].find(key => this.gonePlaces.get(key).every((c, k) => Math.abs(c - place[k]) < 0.5));
    const before = new Set(this.gone);
    if (back) this.gone.delete(back);
    else if (this.patch.held[p]) return this.tell('The rim is held; remove a particle inside it.');
    else {
      this.gonePlaces ??= new Map();
      this.gonePlaces.set(this.patch.keys[p], [this.patch.x[p], this.patch.y[p]]);
      this.gone.add(this.patch.keys[p]);
    }
    if (this.rebuild()) return this.tell(this.gone.size ? `${this.gone.size} removed; the others have moved to new rest positions.` : '');
    this.gone = before;
    this.rebuild();
    return this.tell('Without this particle the lattice buckles; give it a stiffer foundation first.');
  }

  tell(words) {
    this.root.querySelector('.words').textContent = words;
  }

  listen() {
    const {root} = this;
    for (const canvas of Object.values(this.canvases)) {
      canvas.addEventListener('pointerdown', event => {
        const box = canvas.getBoundingClientRect(), [px, py] = [event.clientX - box.left, event.clientY - box.top];
        const {unit} = this.scaleOf(canvas);
        this.cursor = null;
        this.act(this.nearest(canvas, px, py), [(px - canvas.clientWidth / 2) / unit, (canvas.clientHeight / 2 - py) / unit]);
      });
      canvas.addEventListener('keydown', event => {
        const ways = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};
        if (event.key in ways) this.moveCursor(ways[event.key]);
        else if (event.key === 'Enter' || event.key === ' ') this.act(this.cursor ?? this.drive.source);
        else return;
        event.preventDefault();
      });
      canvas.addEventListener('blur', () => { this.cursor = null; this.draw(); });
    }
    const on = (name, act) => root.querySelector(`[name=${name}]`).addEventListener('click', act);
    on('again', () => this.restart());
    on('run', () => { this.playing = !this.playing; this.show(); });
    root.querySelector('[name=slower]').addEventListener('change', event => { this.slower = Number(event.target.value); });
    root.querySelectorAll('[name=tool]').forEach(input => input.addEventListener('change', () => { this.tool = input.value; }));
    if (this.data.law.kind !== 'power') root.querySelector('[name=tool][value=remove]').closest('label').hidden = true;
    new ResizeObserver(() => this.draw()).observe(root);
    this.playing = view.playing;
    new IntersectionObserver(entries => {
      this.seen = entries.at(-1).isIntersecting;
      if (!this.seen || this.playing || this.bursts.complete.t > 0) return;
      for (let k = 0; k < STILL; k++) this.advance(1 / this.drive.carrier_Hz);  // who asks the system for less motion sees one moment of it
    }).observe(root);
    this.show();
  }

  moveCursor([right, up]) {
    const {x, y, size} = this.patch, here = this.cursor ?? this.drive.source;
    let best = here, least = Infinity;
    for (let p = 0; p < size; p++) {
      const along = right * (x[p] - x[here]) + up * (y[p] - y[here]), across = Math.abs(up * (x[p] - x[here]) + right * (y[p] - y[here]));
      if (along > 0.1 && along + 3 * across < least) [best, least] = [p, along + 3 * across];
    }
    this.cursor = best;
    this.draw();
  }

  show() {
    this.root.querySelector('[name=run]').textContent = this.playing ? 'Pause' : 'Play';
  }

  /** The sliders of the page have moved. */
  follow(state) {
    this.state = state;
    if (this.rebuild()) return;
    this.gone.clear();
    this.rebuild();
    this.tell('Without the removed particles this lattice buckles; they are back in place.');
  }

  /** Called for each picture of the browser, with the time that passed in s. */
  frame(passed) {
    if (!this.playing || !this.seen) return;
    this.advance(Math.min(passed, 0.05) / this.slower);
    if (this.over) this.restart();
  }
}

/** A short burst in the middle of a lattice, between the lowest frequencies at the zone centre and the first named point. */
function driveOf(data, state) {
  const [centre, point] = [Math.max(data.path.q.findIndex(q => q[0] === 0 && q[1] === 0), 0), data.path.point.at]
    .map(at => Math.abs(modeOf(data, state, 'complete', data.path.q[at], 0).frequency_Hz));
  return {direction: [0, 1], cycles: CYCLES, damping_per_s: 0.1 * centre, carrier_Hz: (centre + 1.2 * point) / 2.2,
    highest_Hz: Math.max(...sceneBands.flat())};
}

/** Blue for one way, orange for the other, paper at rest: a scale that the colour-blind can read. */
function shade(value, dark) {
  const [orange, blue, rest] = dark ? [[255, 140, 40], [70, 170, 255], [44, 49, 58]] : [[213, 94, 0], [0, 114, 178], [229, 232, 237]];
  const ends = value > 0 ? orange : blue, part = Math.abs(value);
  return `rgb(${ends.map((end, c) => Math.round(rest[c] + (end - rest[c]) * part)).join(',')})`;
}
