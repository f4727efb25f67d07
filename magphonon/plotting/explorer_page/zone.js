// The first Brillouin zone with the path of the chart and the wavevector that is shown, as SVG; x and y as in the lattice.
/** The zone is drawn from -1 to 1; its special points stand around it. */
function drawZone(svg, data, at) {
  const points = data.path.q.map(q => wavevector(data, q));
  const size = Math.max(...[...data.zone, ...points].map(k => Math.hypot(...k)));
  const place = ([x, y], far = 1) => [far * x / size, -far * y / size].map(value => value.toFixed(4)).join(' ');
  const begins = k => k === 0 || data.path.jumps.includes(k);
  const path = points.map((k, n) => `${begins(n) ? 'M' : 'L'}${place(k)}`).join('');
  const names = Object.entries(data.path.named).map(([n, name]) => {
    const k = points[n], away = Math.hypot(...k) > 1e-9 ? place(k, 1 + 0.26 * size / Math.hypot(...k)) : '-0.16 0.2';
    const [x, y] = away.split(' ');
    return `<text x="${x}" y="${y}" dy="0.09">${name}</text>`;
  });
  const k = points[at], [x, y] = place(k).split(' ');
  const head = `<path class="head" transform="translate(${x} ${y}) rotate(${-180 / Math.PI * Math.atan2(k[1], k[0])})"
    d="M0 0L-0.26 -0.11V0.11Z"/>`;
  const arrow = Math.hypot(...k) > 0.05 * size ? `<path class="wave" d="M0 0L${x} ${y}"/>${head}` : '<circle r="0.07"/>';
  svg.innerHTML = `<path class="zone" d="M${data.zone.map(corner => place(corner)).join('L')}Z"/><path class="way" d="${path}"/>`
    + [...new Set(names)].join('') + arrow;
}
