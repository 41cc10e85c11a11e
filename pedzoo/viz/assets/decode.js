// Reads what pedzoo/eval/packed_episodes.py packs.

function numbers(text) {
  const bytes = atob(text), result = [];
  let value = 0, scale = 1;
  for (let i = 0; i < bytes.length; i++) {
    const byte = bytes.charCodeAt(i);
    value += (byte & 127) * scale;
    scale *= 128;
    if (byte < 128) {
      result.push(value % 2 ? -(value + 1) / 2 : value / 2);
      value = 0;
      scale = 1;
    }
  }
  return result;
}

function tracksOf(episode) {
  if (episode.tracks) return episode.tracks;
  const steps = numbers(episode.xy);
  let at = 0;
  return (episode.tracks = episode.counts.map((count) => {
    const xy = new Float32Array(2 * count);
    let x = 0, y = 0, dx = 0, dy = 0;
    for (let i = 0; i < count; i++) {
      dx += steps[at++];
      dy += steps[at++];
      x += dx;
      y += dy;
      xy[2 * i] = x / 1000;
      xy[2 * i + 1] = y / 1000;
    }
    return xy;
  }));
}

// Where a person is at a point of time, which may lie between two points; null while away.
function placeOf(episode, who, point) {
  const person = episode.people[who], xy = tracksOf(episode)[who];
  const along = point - person.first, last = xy.length / 2 - 1;
  if (along < -1e-6 || last < 0) return null;
  const ended = person.first + last >= episode.points;
  if (along > last + 1e-6 && !ended) return null;
  const at = Math.min(Math.max(along, 0), last), i = Math.min(Math.floor(at), Math.max(last - 1, 0));
  const part = at - i, j = Math.min(i + 1, last);
  return [xy[2 * i] * (1 - part) + xy[2 * j] * part, xy[2 * i + 1] * (1 - part) + xy[2 * j + 1] * part];
}

// Velocity over 0.4 s around a point, m/s.
function velocityOf(episode, who, point) {
  const person = episode.people[who], last = person.first + tracksOf(episode)[who].length / 2 - 1;
  const from = Math.max(person.first, point - 2), to = Math.min(last, point + 2);
  if (to <= from) return [0, 0];
  const a = placeOf(episode, who, from), b = placeOf(episode, who, to), time = (to - from) * episode.dt;
  return [(b[0] - a[0]) / time, (b[1] - a[1]) / time];
}

function goalOf(episode, who, point) {
  let result = null;
  for (const goal of episode.people[who].goals) if (result === null || goal[0] <= point) result = goal;
  return result && [result[1], result[2]];
}

function within(runs, point) {
  return runs.some(([first, last]) => first <= point + 1e-6 && point <= last + 1);
}

// The cells of a floor plan as kinds: 0 free, 1 wall, 2 unknown.
function cellsOf(plan) {
  if (plan.cells) return plan.cells;
  const cells = new Uint8Array(plan.rows * plan.columns);
  let at = 0;
  for (const run of numbers(plan.runs)) {
    const length = Math.floor(run / 4);
    cells.fill(run % 4, at, at + length);
    at += length;
  }
  return (plan.cells = cells);
}

// Low and high corner of all that happens in an episode.
function extentOf(episode) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  const grow = (x, y) => {
    box[0] = Math.min(box[0], x);
    box[1] = Math.min(box[1], y);
    box[2] = Math.max(box[2], x);
    box[3] = Math.max(box[3], y);
  };
  tracksOf(episode).forEach((xy, who) => {
    for (let i = 0; i < xy.length; i += 2) grow(xy[i], xy[i + 1]);
    for (const goal of episode.people[who].goals) grow(goal[1], goal[2]);
  });
  return box;
}

// Low and high corner of a floor plan's free cells; null where it is turned against the axes.
function roomOf(plan) {
  if (plan.room !== undefined) return plan.room;
  const cells = cellsOf(plan), [x, y, yaw] = plan.origin;
  let [left, right, low, high] = [plan.columns, -1, plan.rows, -1];
  for (let row = 0; row < plan.rows; row++)
    for (let column = 0; column < plan.columns; column++)
      if (cells[row * plan.columns + column] === 0) {
        left = Math.min(left, column);
        right = Math.max(right, column);
        low = Math.min(low, row);
        high = Math.max(high, row);
      }
  const edge = 0.3;
  plan.room = Math.abs(yaw) > 1e-6 || right < 0 ? null : [
    x + left * plan.cell - edge, y + low * plan.cell - edge,
    x + (right + 1) * plan.cell + edge, y + (high + 1) * plan.cell + edge,
  ];
  return plan.room;
}
