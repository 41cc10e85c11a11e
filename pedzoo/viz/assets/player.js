// Two policies side by side on the same scene, with one clock.

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];
const LAYERS = { trails: "t", space: "p", goals: "g", touches: "c", names: "n" };
const NONE = "";

const keyOf = (episode) => `${episode.seed}.${episode.episode}`;

class Player {
  constructor(data) {
    this.cases = data.cases;
    this.plans = data.plans;
    this.state = { case: 0, a: NONE, b: NONE, episode: NONE, point: 0, playing: false, speed: 1, who: null };
    this.layers = { trails: true, space: false, goals: true, touches: true, names: false };
    this.sides = ["a", "b"].map((side) => this.stage(side));
    if (!this.cases.length) return;
    byId("replay").hidden = false;
    options(byId("case"), this.cases.map((one, i) => [i, one.name]), 0);
    options(byId("speed"), SPEEDS.map((one) => [one, `${one}×`]), 1);
    byId("case").onchange = (event) => this.pick(Number(event.target.value));
    byId("episode").onchange = (event) => this.set({ episode: event.target.value, point: 0, who: null });
    byId("speed").onchange = (event) => this.set({ speed: Number(event.target.value) });
    byId("play").onclick = () => this.toggle();
    byId("time").oninput = (event) => this.set({ point: Number(event.target.value), playing: false });
    for (const name of Object.keys(LAYERS)) byId("layers").append(this.switch(name));
    byId("keys").textContent = "Click a person for speed and distances over time. Keys: space plays, ← → 0.1 s (shift: 1 s), "
      + "↑ ↓ episode, + − speed, home and end, " + Object.entries(LAYERS).map(([name, key]) => `${key} ${name}`).join(", ") + ".";
    this.pick(0);
  }

  stage(side) {
    const select = make("select", { "aria-label": `policy ${side}`, onchange: () => this.set({ [side]: select.value, who: null }) });
    const said = make("span", { className: "said" }), canvas = make("canvas", { tabIndex: 0, role: "img" });
    const node = make("div", { className: "stage" }, make("header", {}, select, said), canvas);
    byId("stages").append(node);
    const result = { side, select, said, canvas, node, scene: new Scene(canvas), here: [] };
    canvas.onclick = (event) => this.click(result, event);
    return result;
  }

  switch(name) {
    const button = make("button", { type: "button", title: LAYERS[name], onclick: () => this.layer(name) }, name);
    button.setAttribute("aria-pressed", this.layers[name]);
    button.id = `layer-${name}`;
    return button;
  }

  layer(name) {
    this.layers[name] = !this.layers[name];
    byId(`layer-${name}`).setAttribute("aria-pressed", this.layers[name]);
    this.draw();
  }

  has(number, policy) {
    return number !== null && this.cases[number].policies.some((one) => one.name === policy);
  }

  policy(name) {
    return this.cases[this.state.case].policies.find((one) => one.name === name);
  }

  episodeOf(side) {
    const policy = this.policy(this.state[side]);
    return policy && policy.episodes.find((one) => keyOf(one) === this.state.episode);
  }

  pick(number, wanted = {}) {
    const policies = this.cases[number].policies.map((one) => one.name), before = this.state;
    const keep = (name, other) => (policies.includes(name) ? name : other);
    const a = keep(wanted.a ?? before.a, policies[0]);
    const b = wanted.b === NONE ? NONE : keep(wanted.b ?? before.b, policies.find((name) => name !== a) ?? NONE);
    this.state = { ...before, case: number, a, b, who: null, point: 0 };
    byId("case").value = String(number);
    options(this.sides[0].select, policies.map((name) => [name, name]), a);
    options(this.sides[1].select, [[NONE, "none"], ...policies.map((name) => [name, name])], b);
    const keys = [...new Set(this.cases[number].policies.flatMap((one) => one.episodes.map(keyOf)))];
    const episode = keys.includes(wanted.episode) ? wanted.episode : keys[0];
    options(byId("episode"), keys.map((key) => [key, `seed ${key.replace(".", ", number ")}`]), episode);
    this.set({ ...wanted, a, b, episode });
  }

  // The episode of a policy that shows most of what a column of the table is about.
  open(number, policy, column) {
    const order = /success|clean|deadlock/.test(column) ? (one) => one.values.success
      : /wall/.test(column) ? (one) => -one.values.wall_contacts
      : /contact|collision|least|personal/.test(column) ? (one) => -one.values.agent_contacts
      : (one) => -one.points;
    const episodes = this.cases[number].policies.find((one) => one.name === policy).episodes;
    const shown = [...episodes].sort((x, y) => order(x) - order(y))[0];
    const b = this.state.b === policy ? this.state.a : this.state.b;
    this.pick(number, { a: policy, b, episode: keyOf(shown) });
    byId("replay").scrollIntoView({ block: "start" });
    this.set({ playing: true });
  }

  set(change) {
    const before = this.state;
    this.state = { ...before, ...change };
    const { state } = this, shown = this.sides.map((one) => this.episodeOf(one.side));
    this.last = Math.max(0, ...shown.map((one) => (one ? one.points : 0)));
    state.point = Math.min(Math.max(state.point, 0), this.last);
    if (["case", "a", "b", "episode"].some((key) => before[key] !== state[key])) this.arrange();
    if (!before.playing && state.playing) {
      if (state.point >= this.last) state.point = 0;
      this.clock = null;
      requestAnimationFrame((now) => this.tick(now));
    }
    byId("play").textContent = state.playing ? "❚❚" : "▶";
    byId("speed").value = String(state.speed);
    if (before.who !== state.who || change.who !== undefined) this.inspect();
    this.draw();
    if (!state.playing) this.link();
  }

  arrange() {
    this.sides.forEach((one) => {
      one.select.value = this.state[one.side];
      one.episode = this.episodeOf(one.side);
      one.plan = one.episode && one.episode.plan !== null ? this.plans[one.episode.plan] : null;
      one.canvas.hidden = !one.episode;
      one.node.hidden = one.side === "b" && this.cases[this.state.case].policies.length < 2;
    });
    byId("episode").value = this.state.episode;
    byId("time").max = String(this.last);
    this.fit();
    drawTicks(byId("ticks"), this.sides, this.last);
  }

  // All that happens in both episodes, and no more than the floor plan: both sides have one scale.
  fit() {
    const shown = this.sides.filter((one) => one.episode);
    if (!shown.length) return;
    const boxes = shown.map((one) => extentOf(one.episode)).filter((box) => box[0] <= box[2]);
    const box = [0, 1, 2, 3].map((i) => boxes.reduce((x, y) => (i < 2 ? Math.min : Math.max)(x, y[i]), i < 2 ? Infinity : -Infinity));
    const room = shown[0].plan && roomOf(shown[0].plan), margin = 0.6;
    const view = !isFinite(box[0]) ? room || [-1, -1, 1, 1] : box.map((value, i) => {
      const wide = i < 2 ? value - margin : value + margin;
      return room ? (i < 2 ? Math.max(wide, Math.min(room[i], value)) : Math.min(wide, Math.max(room[i], value))) : wide;
    });
    for (const one of shown) one.scene.frame(view, 0, Math.max(260, window.innerHeight * 0.6));
  }

  tick(now) {
    if (!this.state.playing) return;
    const passed = this.clock === null ? 0 : Math.min(now - this.clock, 250) / 1000;
    this.clock = now;
    const dt = this.sides[0].episode ? this.sides[0].episode.dt : 0.1;
    this.state.point = Math.min(this.last, this.state.point + (passed * this.state.speed) / dt);
    this.draw();
    if (this.state.point >= this.last && !this.live) this.set({ playing: false });
    else requestAnimationFrame((next) => this.tick(next));
  }

  toggle() {
    this.set({ playing: !this.state.playing });
  }

  draw() {
    const { state } = this;
    for (const one of this.sides) {
      if (!one.episode) {
        one.said.textContent = one.side === "b" && state.b === NONE ? "" : "no such episode";
        continue;
      }
      one.here = one.scene.draw(one.episode, one.plan, state.point, this.layers, this.chosen(one));
      const seconds = one.episode.points * one.episode.dt, over = state.point >= one.episode.points;
      const ending = one.episode.values.failed ? "failed" : `${Math.round(100 * one.episode.values.success)} % arrive`;
      one.said.textContent = over ? `ended at ${seconds.toFixed(1)} s, ${ending}` : `${one.here.length} here`;
    }
    const dt = this.sides[0].episode ? this.sides[0].episode.dt : 0.1;
    byId("time").value = String(Math.round(state.point));
    byId("clock").textContent = `${(state.point * dt).toFixed(1)} s`;
  }

  // The same person on the other side, by slot and number.
  chosen(one) {
    if (this.state.who === null || !one.episode) return -1;
    const [slot, person] = this.state.who.split(".").map(Number);
    return one.episode.people.findIndex((other) => other.slot === slot && other.person === person);
  }

  click(one, event) {
    const place = one.scene.toPlace(event.offsetX, event.offsetY);
    const far = (other) => Math.hypot(other.place[0] - place[0], other.place[1] - place[1]);
    const near = [...one.here].sort((x, y) => far(x) - far(y))[0];
    const reach = Math.max(0.5, (20 * (window.devicePixelRatio || 1)) / one.scene.scale);
    this.set({ who: near && far(near) < reach ? `${near.person.slot}.${near.person.person}` : null });
  }

  inspect() {
    const sides = this.sides.map((one) => ({ one, who: this.chosen(one) })).filter(({ who }) => who >= 0);
    const lines = sides.map(({ one, who }, i) => ({
      name: this.state[one.side], episode: one.episode, who, color: colorOf(one.episode.people[who]), dash: i > 0,
    }));
    drawPerson(byId("person"), lines, null);
  }

  link() {
    const { state } = this, dt = this.sides[0].episode ? this.sides[0].episode.dt : 0.1;
    const words = { case: this.cases[state.case].name, a: state.a, b: state.b, episode: state.episode };
    const hash = new URLSearchParams({ ...words, t: (state.point * dt).toFixed(1), ...(state.who ? { who: state.who } : {}) });
    try {
      history.replaceState(null, "", `#${hash}`);
    } catch {
      // frames of notebooks have no address
    }
  }

  follow(hash) {
    const given = new URLSearchParams(hash.replace(/^#/, ""));
    const name = given.get("case"), number = name === null ? 0 : this.cases.findIndex((one) => one.name === name);
    if (number < 0 || given.size === 0) return;
    const [a, b, episode] = ["a", "b", "episode"].map((key) => given.get(key) ?? undefined);
    const wanted = { a, b, episode };
    this.pick(number, wanted);
    const dt = this.sides[0].episode ? this.sides[0].episode.dt : 0.1;
    this.set({ point: (Number(given.get("t")) || 0) / dt, who: given.get("who") });
  }
}
