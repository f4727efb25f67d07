// The lattice that moves in one mode, as SVG: u(t) = Re e exp(i (2 pi q.l - theta)) in the cell l.
const ACROSS = 5.4;  // spacings from the left to the right of the picture
const LONGEST = 0.2;  // spacings: the largest displacement drawn
const FAINTEST = 0.02;  // of it, from which an unstable mode grows

class Motion {
  constructor(svg, data) {
    Object.assign(this, {svg, data, theta: 0, gain: 1});
    this.layOut();
  }

  /** Draw the particles that fit into the picture, at rest. */
  layOut() {
    const {svg, data} = this;
    const [width, height] = [svg.clientWidth, svg.clientHeight];
    this.unit = Math.max(width, height) / ACROSS;
    const middle = mean(data.positions);
    const reach = Math.ceil(2 * ACROSS / Math.min(...data.cell.map(vector => Math.hypot(...vector))));
    this.particles = [];
    for (let a = -reach; a <= reach; a++) {
      for (let b = data.periods === 2 ? -reach : 0; b <= (data.periods === 2 ? reach : 0); b++) {
        data.positions.forEach((position, j) => {
          const [x, y] = [0, 1].map(k => a * data.cell[0][k] + b * data.cell[1][k] + position[k] - middle[k]);
          const inside = Math.abs(x) < width / 2 / this.unit + 1 && Math.abs(y) < height / 2 / this.unit + 1;
          if (inside) this.particles.push({cell: [a, b], j, place: [width / 2 + this.unit * x, height / 2 - this.unit * y]});
        });
      }
    }
    const lightest = Math.min(...data.masses_kg);
    const radius = ({j}) => 0.15 * this.unit * Math.cbrt(data.masses_kg[j] / lightest);
    const dot = (look, {cell, j, place}, r) => `<circle class="${look}" data-cell="${cell}" data-particle="${j}" r="${r}"
      cx="${place[0]}" cy="${place[1]}"/>`;
    svg.innerHTML = '<path/>' + this.particles.map(particle => dot('rest', particle, radius(particle))).join('')
      + this.particles.map(particle => dot('particle', particle, radius(particle))).join('');
    this.bonds = svg.querySelector('path');
    this.circles = [...svg.querySelectorAll('.particle')];
    if (this.mode) this.draw();
  }

  show(mode, q) {
    Object.assign(this, {mode, q});
    this.draw();
  }

  /** Let a time pass, in seconds of the mode. */
  advance(time) {
    const omega = 2 * Math.PI * this.mode.frequency_Hz;
    if (omega >= 0) {
      this.theta = (this.theta + omega * time) % (2 * Math.PI);
      this.gain = 1;
    } else {
      this.gain *= Math.exp(-omega * time);
      if (this.gain > 1) this.gain = FAINTEST;
    }
    this.draw();
  }

  /** The displacement of a particle in spacings. */
  displacement(cell, j) {
    const angle = 2 * Math.PI * (this.q[0] * cell[0] + this.q[1] * cell[1]) - this.theta;
    return this.mode.shape[j].map(([re, im]) => LONGEST * this.gain * (re * Math.cos(angle) - im * Math.sin(angle)));
  }

  draw() {
    const lines = [];
    this.particles.forEach(({cell, j, place}, n) => {
      const u = this.displacement(cell, j);
      const here = [place[0] + this.unit * u[0], place[1] - this.unit * u[1]];
      this.circles[n].setAttribute('cx', here[0].toFixed(4));
      this.circles[n].setAttribute('cy', here[1].toFixed(4));
      for (const bond of this.data.bonds) {
        if (bond.i !== j) continue;
        const v = this.displacement([cell[0] + bond.shift[0], cell[1] + bond.shift[1]], bond.j);
        const [x, y] = [0, 1].map(c => bond.length * bond.direction[c] + v[c]);
        lines.push(`M${here[0].toFixed(1)} ${here[1].toFixed(1)}`,
          `L${(place[0] + this.unit * x).toFixed(1)} ${(place[1] - this.unit * y).toFixed(1)}`);
      }
    });
    this.bonds.setAttribute('d', lines.join(''));
    Object.assign(this.svg.dataset, {theta: this.theta, gain: this.gain});
  }
}

/** The Cartesian wavevector, in 2 pi over the spacing. */
function wavevector(data, q) {
  return [0, 1].map(x => q[0] * data.reciprocal[0][x] + q[1] * data.reciprocal[1][x]);
}

function mean(points) {
  return [0, 1].map(x => points.reduce((sum, point) => sum + point[x], 0) / points.length);
}
