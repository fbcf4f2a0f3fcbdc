// Puts the lines of a table in the order of a column. Every body is sorted by itself, so that published figures stay below ours.

const SORTED = { lower: "ascending", higher: "descending" }; // the best first, where a column says which is better

// A cell of a number carries it, where its text says more; text is compared as text.
function cellValue(cell, column) {
  if (column && "value" in cell.dataset) return parseFloat(cell.dataset.value);
  const text = cell.textContent.trim();
  return column && !("text" in cell.dataset) ? parseFloat(text) : text;
}

// What has no value stays last, whichever way; and before it what is over fewer rows than others, which was not to do the same.
function rank(cell, value) {
  return typeof value === "number" && Number.isNaN(value) ? 2 : "partial" in cell.dataset ? 1 : 0;
}

function sortBy(table, column, order) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, k) => head.setAttribute("aria-sort", k === column ? order : "none"));
  const compare = (a, b) => {
    const [one, other] = [a.cells[column], b.cells[column]];
    const [x, y] = [cellValue(one, column), cellValue(other, column)];
    const ranks = rank(one, x) - rank(other, y);
    if (ranks || x === y || Number.isNaN(x)) return ranks;
    return (x < y) === (order === "descending") ? 1 : -1;
  };
  for (const body of table.tBodies) body.append(...[...body.rows].sort(compare));
}

function sortable(table) {
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const first = SORTED[head.dataset.better] || "ascending";
    head.querySelector("button")?.addEventListener("click", () => {
      const again = head.getAttribute("aria-sort") === first;
      sortBy(table, column, again ? (first === "ascending" ? "descending" : "ascending") : first);
    });
  });
}
