// Line charts as SVG.

const WIDE = 300, HIGH = 170, LEFT = 42, BOTTOM = 30, TOP = 8, RIGHT = 8;

function ticksOf(low, high) {
  const raw = (high - low) / 4 || 1, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((one) => one * power >= raw) * power, result = [];
  for (let at = Math.ceil(low / step) * step; at <= high + step * 1e-6; at += step) result.push(at);
  return result;
}

const written = (value, log) => (log ? `10^${Number(value.toPrecision(2))}` : String(Number(value.toPrecision(3))));

// lines: [{name, x, y, color, dash, broad}]; gaps are null. marks: horizontal lines [{y, color}].
function chart({ title, x, y, lines, marks = [], at = null, zero = true, log = false }) {
  const scaled = (value) => (log && value !== null ? Math.log10(Math.max(value, 1e-9)) : value);
  const drawn = lines.map((line) => ({ ...line, points: line.x.map((one, i) => [scaled(one), scaled(line.y[i])]) }));
  const known = drawn.flatMap((line) => line.points.filter((point) => point[1] !== null));
  if (!known.length) return make("figure", {}, make("h3", {}, title), make("p", { className: "note" }, "no values"));
  const xs = known.map((point) => point[0]), ys = known.map((point) => point[1]);
  const smallest = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
  const largest = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);
  let [x0, x1, y0, y1] = [smallest(xs), largest(xs), smallest(ys), largest(ys)];
  if (zero && !log) y0 = Math.min(0, y0);
  if (y1 <= y0) y1 = y0 + 1;
  if (x1 <= x0) x1 = x0 + 1;
  y1 += 0.04 * (y1 - y0);
  const px = (value) => LEFT + ((value - x0) / (x1 - x0)) * (WIDE - LEFT - RIGHT);
  const py = (value) => HIGH - BOTTOM - ((value - y0) / (y1 - y0)) * (HIGH - BOTTOM - TOP);
  const picture = svg("svg", { viewBox: `0 0 ${WIDE} ${HIGH}`, role: "img" }, svg("title", {}, title));
  for (const tick of ticksOf(y0, y1)) {
    picture.append(svg("line", { class: "axis", x1: LEFT, x2: WIDE - RIGHT, y1: py(tick), y2: py(tick) }));
    picture.append(svg("text", { x: LEFT - 5, y: py(tick) + 4, "text-anchor": "end" }, written(tick, log)));
  }
  for (const tick of ticksOf(x0, x1))
    picture.append(svg("text", { x: px(tick), y: HIGH - BOTTOM + 13, "text-anchor": "middle" }, written(tick, log)));
  picture.append(svg("text", { x: (LEFT + WIDE) / 2, y: HIGH - 3, "text-anchor": "middle" }, x));
  for (const mark of marks)
    if (mark.y >= y0 && mark.y <= y1)
      picture.append(svg("line", {
        x1: LEFT, x2: WIDE - RIGHT, y1: py(mark.y), y2: py(mark.y), stroke: mark.color, "stroke-dasharray": "2 3",
      }));
  for (const line of drawn) {
    let path = "", pen = false;
    for (const [a, b] of line.points) {
      if (b === null) pen = false;
      else {
        path += `${pen ? "L" : "M"}${px(a).toFixed(1)} ${py(b).toFixed(1)}`;
        pen = true;
      }
    }
    picture.append(svg("path", {
      d: path, fill: "none", stroke: line.color, "stroke-width": line.broad ? 2.6 : 1.5,
      "stroke-dasharray": line.dash ? "5 3" : "none", "stroke-linejoin": "round",
    }, svg("title", {}, line.name)));
    if (line.points.length < 30)
      for (const [a, b] of line.points)
        if (b !== null) picture.append(svg("circle", { cx: px(a), cy: py(b), r: 2, fill: line.color }));
  }
  if (at !== null && at >= x0 && at <= x1)
    picture.append(svg("line", { x1: px(at), x2: px(at), y1: TOP, y2: HIGH - BOTTOM, stroke: theme("accent") }));
  const name = y ? `${title}, ${y}` : title;
  return make("figure", {}, make("h3", {}, name), picture);
}

function legend(lines) {
  const node = make("div", { className: "legend" });
  for (const line of lines) {
    const swatch = make("i");
    swatch.style.borderTopColor = line.color;
    if (line.dash) swatch.style.borderTopStyle = "dashed";
    node.append(make("span", {}, swatch, line.name));
  }
  return node;
}

function drawCharts(groups, home) {
  home.hidden = !groups.length;
  home.replaceChildren();
  for (const group of groups) {
    const names = [...new Set(group.panels.flatMap((panel) => panel.lines.map((line) => line.name)))];
    const others = names.filter((name) => name !== "real");
    const look = (name) => {
      const i = others.indexOf(name);
      return name === "real" ? { color: theme("real"), broad: true }
        : { color: PALETTE[i % PALETTE.length], dash: i >= PALETTE.length };
    };
    const lines = (panel) => panel.lines.map((line) => ({ ...line, ...look(line.name) }));
    home.append(
      make("h2", {}, group.title),
      make("p", { className: "note" }, group.note || ""),
      legend(names.map((name) => ({ name, ...look(name) }))),
      make("div", { className: "plots" }, ...group.panels.map((panel) => chart({ ...panel, lines: lines(panel) }))),
    );
  }
}
