// Draws one moment of an episode from above.

const PALETTE = [
  "#d62728", "#1f77b4", "#2ca02c", "#ff7f0e", "#9467bd", "#17becf", "#e377c2", "#bcbd22", "#8c564b", "#5b8def",
];
const PERSONAL = 0.5; // metres between centres, as the metric personal_space has it
const GOAL = 0.3; // metres
const TRAIL = 40; // points
const BANDS = 5;
const BODY = 0.15; // metres: figures grow with their bodies
const FIGURE = { along: 0.13, across: 0.23, head: 0.1, face: 0.07, ahead: 0.05 }; // as pedzoo.sim.drawing
const SKIN = "rgb(226,180,150)", HAIR = "rgb(66,48,40)", EDGE = "rgb(40,40,40)";

const colorOf = (person) => PALETTE[((person.person % PALETTE.length) + PALETTE.length) % PALETTE.length];
const theme = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.floors = new Map();
    this.restyle();
  }

  restyle() {
    this.colors = {};
    for (const name of ["paper", "ink", "soft", "floor", "wall", "outside", "touch", "accent"])
      this.colors[name] = theme(name);
    this.floors.clear();
    this.still = null;
  }

  // What is seen: low and high corner, metres. The canvas gets the height that shows it at full width.
  frame(box, margin, tallest) {
    const [x0, y0, x1, y1] = [box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin];
    const width = this.canvas.clientWidth || 600, ratio = window.devicePixelRatio || 1;
    const wide = Math.max(x1 - x0, 1), high = Math.max(y1 - y0, 1);
    const height = Math.round(Math.max(140, Math.min(tallest, (width * high) / wide)));
    this.canvas.style.height = height + "px";
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.scale = Math.min(width / wide, height / high) * ratio;
    this.middle = [(x0 + x1) / 2, (y0 + y1) / 2];
    this.still = null;
  }

  toPixel(place) {
    return [
      this.canvas.width / 2 + (place[0] - this.middle[0]) * this.scale,
      this.canvas.height / 2 - (place[1] - this.middle[1]) * this.scale,
    ];
  }

  toPlace(x, y) {
    const ratio = this.canvas.width / (this.canvas.clientWidth || 1);
    return [
      this.middle[0] + (x * ratio - this.canvas.width / 2) / this.scale,
      this.middle[1] - (y * ratio - this.canvas.height / 2) / this.scale,
    ];
  }

  floorOf(plan) {
    if (this.floors.has(plan)) return this.floors.get(plan);
    const image = document.createElement("canvas");
    image.width = plan.columns;
    image.height = plan.rows;
    const context = image.getContext("2d"), cells = cellsOf(plan);
    context.fillStyle = this.colors.floor;
    context.fillRect(0, 0, plan.columns, plan.rows);
    for (let row = 0; row < plan.rows; row++)
      for (let column = 0; column < plan.columns; ) {
        const kind = cells[row * plan.columns + column];
        let end = column + 1;
        while (end < plan.columns && cells[row * plan.columns + end] === kind) end++;
        if (kind) {
          context.fillStyle = kind === 1 ? this.colors.wall : this.colors.outside;
          context.fillRect(column, row, end - column, 1);
        }
        column = end;
      }
    this.floors.set(plan, image);
    return image;
  }

  // The floor as it lies in this view; it is drawn once.
  ground(plan) {
    if (this.still && this.stillOf === plan) return this.still;
    const image = document.createElement("canvas"), context = image.getContext("2d", { alpha: false });
    image.width = this.canvas.width;
    image.height = this.canvas.height;
    context.fillStyle = plan ? this.colors.outside : this.colors.floor;
    context.fillRect(0, 0, image.width, image.height);
    if (plan) {
      const [x, y, yaw] = plan.origin, [left, top] = this.toPixel([x, y]), side = plan.cell * this.scale;
      const c = Math.cos(yaw) * side, s = Math.sin(yaw) * side;
      context.setTransform(c, -s, -s, -c, left, top);
      context.imageSmoothingEnabled = side < 1;
      context.drawImage(this.floorOf(plan), 0, 0);
    }
    [this.still, this.stillOf] = [image, plan];
    return image;
  }

  draw(episode, plan, point, layers, chosen) {
    const context = this.context;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.ground(plan), 0, 0);
    const here = [];
    episode.people.forEach((person, who) => {
      const place = placeOf(episode, who, point);
      if (place) here.push({ who, person, place, pixel: this.toPixel(place), color: colorOf(person) });
    });
    for (const one of here) {
      if (layers.goals) this.goal(episode, one, point);
      if (layers.trails) this.trail(episode, one, point);
    }
    if (layers.space) for (const one of here) this.space(one);
    if (layers.touches) this.touches(episode, point);
    for (const one of here) this.body(episode, one, point, layers, one.who === chosen);
    return here;
  }

  goal(episode, one, point) {
    const goal = goalOf(episode, one.who, point);
    if (!goal) return;
    const context = this.context, [x, y] = this.toPixel(goal), arm = Math.max(3, 0.09 * this.scale);
    context.strokeStyle = one.color;
    context.lineWidth = Math.max(1, this.scale * 0.025);
    context.beginPath();
    context.arc(x, y, GOAL * this.scale, 0, 7);
    for (const side of [-1, 1]) {
      context.moveTo(x - arm, y - side * arm);
      context.lineTo(x + arm, y + side * arm);
    }
    context.stroke();
  }

  // In a few bands: each piece on its own would cost a stroke.
  trail(episode, one, point) {
    const context = this.context, xy = tracksOf(episode)[one.who], first = one.person.first;
    const last = Math.min(Math.floor(point) - first, xy.length / 2 - 1), band = TRAIL / BANDS;
    context.strokeStyle = one.color;
    context.lineWidth = Math.max(1.5, this.scale * 0.05);
    for (let part = 0; part < BANDS; part++) {
      const to = last - part * band, from = Math.max(0, to - band);
      if (to <= 0) break;
      context.globalAlpha = 0.75 * (1 - part / BANDS);
      context.beginPath();
      for (let i = from; i <= to; i++) this.line(xy[2 * i], xy[2 * i + 1]);
      if (part === 0) context.lineTo(...one.pixel);
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  line(x, y) {
    const column = this.canvas.width / 2 + (x - this.middle[0]) * this.scale;
    this.context.lineTo(column, this.canvas.height / 2 - (y - this.middle[1]) * this.scale);
  }

  space(one) {
    const context = this.context;
    context.fillStyle = one.color;
    context.globalAlpha = 0.13;
    context.beginPath();
    context.arc(...one.pixel, PERSONAL * this.scale, 0, 7);
    context.fill();
    context.globalAlpha = 1;
  }

  // A ring stays where a touch began.
  touches(episode, point) {
    const context = this.context;
    context.strokeStyle = this.colors.touch;
    context.lineWidth = Math.max(1.5, this.scale * 0.03);
    episode.people.forEach((person, who) => {
      for (const [first] of [...person.touch, ...person.wall]) {
        if (first > point) continue;
        const place = placeOf(episode, who, first);
        if (!place) continue;
        context.beginPath();
        context.arc(...this.toPixel(place), Math.max(4, 0.1 * this.scale), 0, 7);
        context.stroke();
      }
    });
  }

  oval(ahead, along, across, color) {
    this.context.fillStyle = color;
    this.context.beginPath();
    this.context.ellipse(ahead, 0, along, across, 0, 0, 7);
    this.context.fill();
  }

  body(episode, one, point, layers, chosen) {
    const context = this.context, [x, y] = one.pixel, radius = Math.max(2.5, one.person.radius * this.scale);
    const touching = within(one.person.touch, point) || within(one.person.wall, point);
    const [vx, vy] = velocityOf(episode, one.who, point);
    if (Math.hypot(vx, vy) > 0.05) one.person.facing = Math.atan2(-vy, vx);
    const facing = one.person.facing || 0;
    context.save();
    context.translate(x, y);
    context.rotate(facing);
    context.fillStyle = one.color;
    if (one.person.robot) {
      context.fillStyle = this.colors.ink;
      context.fillRect(-radius, -radius * 0.85, 2 * radius, 1.7 * radius);
      context.fillStyle = "#ffb020";
      context.fillRect(radius * 0.35, -radius * 0.5, radius * 0.3, radius);
    } else {
      const size = radius / BODY, edge = Math.max(1, this.scale * 0.012);
      // the edge first, then shoulders, the disc that touches, hair and face
      this.oval(0, FIGURE.along * size + edge, FIGURE.across * size + edge, EDGE);
      this.oval(0, radius + edge, radius + edge, EDGE);
      this.oval(0, FIGURE.along * size, FIGURE.across * size, one.color);
      this.oval(0, radius, radius, one.color);
      this.oval(0, FIGURE.head * size, FIGURE.head * size, HAIR);
      this.oval(FIGURE.ahead * size, FIGURE.face * size, FIGURE.face * size, SKIN);
    }
    context.restore();
    if (touching || chosen) {
      context.strokeStyle = touching ? this.colors.touch : this.colors.accent;
      context.lineWidth = Math.max(2, this.scale * 0.04);
      context.beginPath();
      context.arc(x, y, radius * 1.7 + 2, 0, 7);
      context.stroke();
    }
    if (layers.names) {
      context.fillStyle = this.colors.ink;
      context.font = Math.round(11 * (window.devicePixelRatio || 1)) + "px system-ui, sans-serif";
      context.fillText(String(one.person.person), x + radius * 1.6, y - radius);
    }
  }
}
