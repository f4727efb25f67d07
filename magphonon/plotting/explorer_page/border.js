// The border of buckling: where the lowest squared frequency of the complete model falls below zero.
/** The foundation in N/m that the lattice needs, by linear interpolation of what magphonon computed over the whole zone. */
function neededFoundation(data, state) {
  const {over, at, needed_N_per_m: needed} = data.border;
  const scale = state.spacing_m / data.spacing_m;
  if (over === 'spacing') return interpolated(at, needed, scale);
  return interpolated(at, needed, state.exponent) * scale ** -(state.exponent + 1);  // all stiffnesses go with f/L
}

function interpolated(x, y, at) {
  const above = Math.min(Math.max(x.findIndex(value => value >= at), 1), x.length - 1);  // a last one beyond rounding is -1
  const share = (at - x[above - 1]) / (x[above] - x[above - 1]);
  return y[above - 1] + share * (y[above] - y[above - 1]);
}

function buckles(data, state) {
  return neededFoundation(data, state) > (1 + 1e-9) * state.foundation_N_per_m;  // not by a rounding, on the border itself
}

/** The ranges of one quantity in which the lattice buckles while the others stay: [from, to], null at an end of the slider. */
function bucklingRanges(data, state, key, values) {
  const ranges = [];
  const at = value => buckles(data, {...state, [key]: value});
  values.forEach((value, k) => {
    const now = at(value), before = k > 0 && at(values[k - 1]);
    if (now && k === 0) ranges.push([null, null]);
    if (k > 0 && now !== before) {
      const border = change(at, values[k - 1], value);
      if (now) ranges.push([border, null]);
      else ranges[ranges.length - 1][1] = border;
    }
  });
  return ranges;
}

/** Where between two values, of which one holds, it changes. */
function change(holds, low, high) {
  const first = holds(low);
  for (let k = 0; k < 60; k++) {
    const middle = (low + high) / 2;
    if (holds(middle) === first) low = middle;
    else high = middle;
  }
  return (low + high) / 2;
}
