// What one person does over time: speed, nearest distance, time to collision.

const HORIZON = 10; // seconds

function othersAt(episode, who, point) {
  const result = [];
  episode.people.forEach((person, other) => {
    if (other === who) return;
    const place = placeOf(episode, other, point);
    if (place) result.push({ other, person, place });
  });
  return result;
}

// Seconds until two discs meet if both keep their velocities; Infinity if they never do.
function collisionSeconds(dx, dy, vx, vy, reach) {
  const along = dx * vx + dy * vy, speed = vx * vx + vy * vy, gap = dx * dx + dy * dy - reach * reach;
  if (gap <= 0) return 0;
  const inside = along * along - speed * gap;
  return along >= 0 || inside < 0 || speed === 0 ? Infinity : (-along - Math.sqrt(inside)) / speed;
}

function courses(episode, who) {
  const person = episode.people[who], count = tracksOf(episode)[who].length / 2;
  const every = Math.max(1, Math.floor(count / 300)), result = { time: [], speed: [], near: [], collision: [] };
  for (let i = 0; i < count; i += every) {
    const point = person.first + i, place = placeOf(episode, who, point), mine = velocityOf(episode, who, point);
    let near = null, soonest = HORIZON;
    for (const one of othersAt(episode, who, point)) {
      const dx = one.place[0] - place[0], dy = one.place[1] - place[1], theirs = velocityOf(episode, one.other, point);
      const distance = Math.hypot(dx, dy);
      near = near === null ? distance : Math.min(near, distance);
      const reach = person.radius + one.person.radius;
      soonest = Math.min(soonest, collisionSeconds(dx, dy, theirs[0] - mine[0], theirs[1] - mine[1], reach));
    }
    result.time.push(point * episode.dt);
    result.speed.push(Math.hypot(...mine));
    result.near.push(near);
    result.collision.push(near === null ? null : soonest);
  }
  return result;
}

// sides: [{name, episode, who, color, dash}], the first one is the person that was clicked.
function drawPerson(home, sides, seconds) {
  home.hidden = !sides.length;
  home.replaceChildren();
  if (!sides.length) return;
  const all = sides.map((side) => ({ ...side, course: courses(side.episode, side.who) }));
  const person = sides[0].episode.people[sides[0].who];
  const lines = (key) => all.map(({ name, color, dash, course }) => ({ name, color, dash, x: course.time, y: course[key] }));
  const touch = [{ y: 2 * person.radius, color: theme("touch") }];
  const panels = [
    { title: "speed", y: "m/s", lines: lines("speed") },
    { title: "nearest person, between centres", y: "m", lines: lines("near"), marks: touch },
    { title: "time to collision, at most 10 s", y: "s", lines: lines("collision") },
  ];
  home.append(
    make("h3", {}, `${person.robot ? "robot" : "person"} ${person.person}`),
    legend(sides),
    make("div", { className: "plots" }, ...panels.map((panel) => chart({ ...panel, x: "time, s", at: seconds }))),
  );
}
