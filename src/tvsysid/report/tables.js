"use strict";
document.querySelectorAll("table.sortable").forEach((table) => {
  const body = table.tBodies[0];
  const headings = [...table.tHead.rows[0].cells];
  const value = (row, column) => {
    const cell = row.cells[column];
    if (!cell.classList.contains("number")) return cell.textContent;
    const number = parseFloat(cell.textContent.replace("−", "-").replaceAll(",", ""));
    return Number.isNaN(number) ? null : number;
  };
  const compare = (a, b) => typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true });
  headings.forEach((heading, column) => heading.querySelector("button").addEventListener("click", () => {
    const sign = heading.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    headings.forEach((other) => other.removeAttribute("aria-sort"));
    heading.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
    // What is missing stays last, whichever way the rest is sorted.
    body.append(...[...body.rows].sort((one, two) => {
      const a = value(one, column), b = value(two, column);
      if (a === null || b === null) return (a === null) - (b === null);
      return sign * compare(a, b);
    }));
  }));
});
document.querySelectorAll(".chooser").forEach((chooser) => {
  const [choice, count] = [chooser.querySelector("select"), chooser.querySelector("span")];
  const rows = [...document.getElementById(choice.id.replace("-choice", "")).tBodies[0].rows];
  const choose = () => {
    rows.forEach((row) => { row.hidden = choice.value !== "" && row.dataset.group !== choice.value; });
    count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
  };
  choice.addEventListener("change", choose);
  chooser.hidden = false;
  choose();
});
