// The table of policies: sortable, the best marked, every number leads to an episode.

function bestOf(rows, column) {
  if (!column.better) return new Set();
  const cells = rows.filter((row) => !row.reference && row.cells[column.key]);
  const values = cells.map((row) => column.better * row.cells[column.key][0]);
  const best = values.reduce((a, b) => Math.max(a, b), -Infinity);
  return new Set(values.some((value) => value < best) ? cells.filter((_, i) => values[i] === best) : []);
}

function cellOf(row, column, best, open) {
  const cell = row.cells[column.key];
  if (!cell) return make("td", {}, "–");
  const [value, low, high] = cell, text = short(value) + (row.seen ? "*" : "");
  const inside = [text];
  if (low !== null) inside.push(make("small", {}, `${short(low)} to ${short(high)}`));
  const node = make("td", { className: best.has(row) ? "best" : "" });
  if (open) {
    const label = `${row.name}, ${column.key} ${text}: show an episode`;
    node.append(make("button", { type: "button", onclick: () => open(row, column), "aria-label": label }, ...inside));
  } else node.append(...inside);
  return node;
}

class Table {
  constructor(group, player) {
    this.group = group;
    this.player = player;
    this.sort = null;
    this.place = make("div", { className: "wide", tabIndex: 0, role: "region", "aria-label": group.name });
    this.choice = make("select", { onchange: () => this.draw() });
    const names = group.tables.map((table, i) => [i, table.title]);
    options(this.choice, names, 0);
    this.node = make("div", {}, make("h2", {}, group.name));
    if (names.length > 1) this.node.append(make("div", { className: "bar" }, make("label", {}, "cases ", this.choice)));
    this.all = make("button", { type: "button", onclick: () => this.more() }, "all columns");
    this.all.setAttribute("aria-pressed", "false");
    this.all.hidden = group.tables.every((table) => table.columns.every((column) => column.first));
    this.node.append(make("p", { className: "note" }, group.note), this.place, make("div", { className: "bar" }, this.all));
    this.draw();
  }

  draw() {
    const table = this.group.tables[Number(this.choice.value)], rows = [...table.rows];
    if (this.sort) {
      const { key, sign } = this.sort;
      const value = (row) => (row.cells[key] ? row.cells[key][0] : null);
      rows.sort((a, b) => {
        if (key === null) return sign * a.name.localeCompare(b.name);
        if (value(a) === null || value(b) === null) return (value(a) === null) - (value(b) === null);
        return sign * (value(a) - value(b));
      });
    }
    const all = this.all.getAttribute("aria-pressed") === "true";
    const columns = table.columns.filter((column) => all || column.first);
    const head = make("tr", {}, this.heading("policy", null, "", 1), make("th", { scope: "col" }, "n"));
    for (const column of columns) head.append(this.heading(column.key, column.key, column.help, -(column.better || 1)));
    const body = make("tbody");
    const bests = columns.map((column) => bestOf(rows, column));
    for (const row of rows) {
      const line = make("tr", {}, make("th", { scope: "row" }, row.name.replace(/[.:,+]/g, "$&\u200b")), make("td", {}, String(row.n)));
      const open = this.target(table, row) ? (one, column) => this.open(table, one, column) : null;
      columns.forEach((column, i) => line.append(cellOf(row, column, bests[i], open)));
      body.append(line);
    }
    this.place.replaceChildren(make("table", {}, make("thead", {}, head), body));
  }

  more() {
    this.all.setAttribute("aria-pressed", String(this.all.getAttribute("aria-pressed") === "false"));
    this.draw();
  }

  heading(text, key, help, first) {
    const mine = this.sort && this.sort.key === key, th = make("th", { scope: "col", title: help || "" });
    if (mine) th.setAttribute("aria-sort", this.sort.sign > 0 ? "ascending" : "descending");
    const onclick = () => {
      this.sort = { key, sign: mine ? -this.sort.sign : first };
      this.draw();
    };
    const words = text.replaceAll("_", "_\u200b") + (mine ? (this.sort.sign > 0 ? " ▲" : " ▼") : "");
    th.append(make("button", { type: "button", onclick, tabIndex: 0 }, words));
    return th;
  }

  // Tables of single cases that have episodes of this row's policy.
  target(table, row) {
    const single = table.case === null ? this.group.tables.filter((one) => one.case !== null) : [table];
    return single.some((one) => this.player.has(one.case, row.name));
  }

  open(table, row, column) {
    const single = (table.case === null ? this.group.tables.filter((one) => one.case !== null) : [table])
      .filter((one) => this.player.has(one.case, row.name));
    const badness = (one) => {
      const same = one.rows.find((other) => other.name === row.name), cell = same && same.cells[column.key];
      return cell ? -(column.better || -1) * cell[0] : -Infinity;
    };
    single.sort((a, b) => badness(b) - badness(a));
    this.player.open(single[0].case, row.name, column.key);
  }
}

function drawTables(groups, home, player) {
  home.hidden = !groups.length;
  home.replaceChildren(...groups.map((group) => new Table(group, player).node));
}
