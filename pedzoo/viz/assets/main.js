// Puts the page together.

function drawTicks(canvas, sides, last) {
  const ratio = window.devicePixelRatio || 1, context = canvas.getContext("2d");
  canvas.width = Math.round((canvas.clientWidth || 600) * ratio);
  canvas.height = Math.round(10 * ratio);
  context.fillStyle = theme("touch");
  sides.forEach((one, row) => {
    for (const person of one.episode ? one.episode.people : [])
      for (const [first] of [...person.touch, ...person.wall])
        context.fillRect((first / Math.max(last, 1)) * (canvas.width - 2), row * 5 * ratio, 2 * ratio, 4 * ratio);
  });
}

function keyboard(player) {
  document.addEventListener("keydown", (event) => {
    const tag = event.target.tagName;
    if (event.ctrlKey || event.metaKey || event.altKey || tag === "SELECT" || !player.cases.length) return;
    if (event.key === " " && tag === "BUTTON" && event.target.id !== "play") return;
    const { state } = player, step = event.shiftKey ? 10 : 1;
    const move = (to) => player.set({ point: to, playing: false });
    const episode = (by) => {
      const keys = [...byId("episode").options].map((one) => one.value);
      const next = keys[keys.indexOf(state.episode) + by];
      if (next !== undefined) player.set({ episode: next, point: 0, who: null });
    };
    const speed = (by) => {
      const next = SPEEDS[SPEEDS.indexOf(state.speed) + by];
      if (next !== undefined) player.set({ speed: next });
    };
    const actions = {
      " ": () => player.toggle(), ArrowRight: () => move(Math.round(state.point) + step),
      ArrowLeft: () => move(Math.round(state.point) - step), Home: () => move(0), End: () => move(player.last),
      ArrowDown: () => episode(1), ArrowUp: () => episode(-1), "+": () => speed(1), "=": () => speed(1), "-": () => speed(-1),
      Escape: () => player.set({ who: null }),
    };
    for (const [name, key] of Object.entries(LAYERS)) actions[key] = () => player.layer(name);
    if (!actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
  });
}

// People who walk now: the whole episode so far comes again and again, and is followed at its end.
async function watch(player, address) {
  player.live = true;
  for (;;) {
    const answer = await fetch(address).then((one) => one.json()).catch(() => null);
    if (!answer) break;
    const late = player.state.point >= player.last - 15;
    player.cases[0].policies[0].episodes = [answer.episode];
    Object.assign(player.plans, answer.plans);
    const fresh = keyOf(answer.episode) !== player.state.episode;
    if (fresh) player.pick(0, { playing: true });
    player.last = answer.episode.points;
    player.arrange();
    if (late && !player.state.playing) player.set({ playing: true });
    if (answer.over) break;
    await new Promise((resolve) => setTimeout(resolve, 250));
  }
  player.live = false;
}

function start() {
  const data = JSON.parse(byId("data").textContent), hash = location.hash; // the player writes its own
  const player = new Player(data);
  byId("about").textContent = data.about;
  drawTables(data.tables, byId("tables"), player);
  drawCharts(data.charts, byId("charts"));
  byId("notes").append(...data.notes.map((text) => make("p", {}, text)));
  keyboard(player);
  if (player.cases.length) {
    player.follow(hash);
    addEventListener("hashchange", () => player.follow(location.hash));
    const redraw = () => {
      player.sides.forEach((one) => one.scene.restyle());
      player.arrange();
      player.inspect();
      player.draw();
      drawCharts(data.charts, byId("charts"));
    };
    addEventListener("resize", redraw);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  }
  if (data.live) watch(player, data.live);
}

start();
