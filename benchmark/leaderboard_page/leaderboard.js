// Chooses data set, task and metric; with one metric, lines are sorted by it and a column shows means and intervals on one scale.

const byId = (id) => document.getElementById(id);
const MARGIN = 3; // percent of a plot on either side
const NARROW = 700; // pixels: below, a page begins with one metric, which fits

// The column of a metric in a table, or -1.
function columnOf(table, metric) {
  return [...table.tHead.rows[0].cells].findIndex((head) => head.dataset.metric === metric);
}

// The last cell of each line, made when it is first needed.
function plotCell(row, tag) {
  const last = row.cells[row.cells.length - 1];
  if (last.classList.contains("plot")) return last;
  const cell = document.createElement(tag);
  cell.className = "plot";
  row.append(cell);
  return cell;
}

// An element of the class, from ``left`` to ``right`` percent of its cell.
function mark(kind, left, right = left) {
  const found = document.createElement("span");
  found.className = kind;
  found.style.left = `${left}%`;
  found.style.width = `${right - left}%`;
  return found;
}

function plot(table, column) {
  const lines = [...table.tBodies].flatMap((body) => [...body.rows]).map((row) => {
    const { value, half } = row.cells[column].dataset;
    return { row, mean: parseFloat(value), half: half ? parseFloat(half) : 0 };
  });
  const known = lines.filter(({ mean }) => Number.isFinite(mean));
  const low = Math.min(...known.map(({ mean, half }) => mean - half));
  const high = Math.max(...known.map(({ mean, half }) => mean + half));
  const place = (value) => (high > low ? MARGIN + ((value - low) / (high - low)) * (100 - 2 * MARGIN) : 50);
  const ends = document.createElement("span");
  ends.className = "ends";
  for (const end of high > low ? [low, high] : known.length ? [low] : []) {
    const text = document.createElement("span");
    text.textContent = end.toPrecision(3);
    ends.append(text);
  }
  plotCell(table.tHead.rows[0], "th").replaceChildren(ends);
  for (const { row, mean, half } of lines) {
    const scale = document.createElement("div");
    scale.className = "scale";
    if (Number.isFinite(mean)) {
      if (half) scale.append(mark("bar", place(mean - half), place(mean + half)));
      scale.append(mark("dot", place(mean)));
    }
    plotCell(row, "td").replaceChildren(scale);
  }
}

// Shows one metric's column alone, or all of them.
function showMetric(table, metric) {
  const column = columnOf(table, metric);
  const heads = [...table.tHead.rows[0].cells];
  const other = (head) => ("metric" in head.dataset ? head.dataset.metric !== metric : "cost" in head.dataset && window.innerWidth < NARROW);
  const hidden = heads.map((head) => Boolean(metric) && other(head));
  for (const row of [...table.tHead.rows, ...[...table.tBodies].flatMap((body) => [...body.rows])]) {
    [...row.cells].forEach((cell, k) => { cell.hidden = Boolean(hidden[k]); });
  }
  table.classList.toggle("plotted", column >= 0);
  if (column < 0) return;
  sortBy(table, column, SORTED[heads[column].dataset.better]);
  plot(table, column);
}

function choose() {
  const [collection, task, metric] = ["collection", "task", "metric"].map((id) => byId(id).value);
  let shown = 0;
  document.querySelectorAll("#tables article").forEach((article) => {
    const table = article.querySelector("table");
    const here = (!collection || article.dataset.collection === collection) && (!task || article.dataset.task === task);
    article.hidden = !here || (metric && columnOf(table, metric) < 0);
    if (article.hidden) return;
    shown += 1;
    showMetric(table, metric);
  });
  byId("nothing").hidden = shown > 0;
}

// What a link leads to is opened.
function openTarget() {
  const target = location.hash && byId(decodeURIComponent(location.hash.slice(1)));
  if (target && target.tagName === "DETAILS") target.open = true;
}

document.querySelectorAll("table.sortable").forEach(sortable);
document.querySelectorAll("#tables table").forEach((table) => {
  const column = [...table.tHead.rows[0].cells].findIndex((head) => head.dataset.metric);
  if (column >= 0) table.tHead.rows[0].cells[column].setAttribute("aria-sort", SORTED[table.tHead.rows[0].cells[column].dataset.better]);
});
if (window.innerWidth < NARROW) byId("metric").selectedIndex = Math.min(1, byId("metric").options.length - 1);
byId("choice").hidden = false;
byId("choice").addEventListener("change", choose);
byId("choice").addEventListener("submit", (event) => event.preventDefault());
window.addEventListener("hashchange", openTarget);
choose();
openTarget();
