// The table of episodes: a cursor moved by keys, a strip of the focused episode, labels for it or the selected ones.
(() => {
  const table = document.getElementById('episodes');
  if (!table) return;
  const rows = [...table.tBodies[0].rows];
  const byId = new Map(rows.map((row) => [row.dataset.id, row]));
  const labels = 'labels' in table.dataset;
  const element = (id) => document.getElementById(id);
  const bar = element('bar');
  const box = (row) => row.querySelector('input[type=checkbox]');
  const STRIP = 8;
  let cursor = -1;
  let lastBox = null;

  function tag(outcome) {
    return Object.assign(document.createElement('span'), { className: `tag ${outcome}`, textContent: outcome });
  }

  // Frames of the episode under the cursor, evenly spaced from its first step to its last.
  function strip(row) {
    const { frames, steps } = row.dataset;
    if (!frames) return;
    const last = Math.max(Number(steps) - 1, 0);
    const shown = Math.min(STRIP, last + 1);
    element('strip').replaceChildren(...Array.from({ length: shown }, (_, place) => {
      const step = Math.round(place * last / Math.max(shown - 1, 1));
      const image = new Image(Number(table.dataset.width), Number(table.dataset.height));
      image.src = `${frames}${step}?size=320`;
      image.alt = `Step ${step}`;
      image.title = `Step ${step}`;
      return image;
    }));
  }

  // The next episode's frames are loaded ahead.
  function ahead(row) {
    if (!row?.dataset.frames) return;
    const last = Math.max(Number(row.dataset.steps) - 1, 0);
    for (let place = 0; place < STRIP; place += 1) {
      new Image().src = `${row.dataset.frames}${Math.round(place * last / (STRIP - 1))}?size=320`;
    }
  }

  function head(row) {
    if (!bar) return;
    const place = document.createElement('span');
    place.className = 'soft';
    place.textContent = ` ${cursor + 1} of ${rows.length} `;
    const name = row.querySelector('td.name a').cloneNode(true);
    element('focused').replaceChildren(name, place, tag(row.dataset.outcome));
  }

  let settle = 0;
  function move(to, focus = true) {
    if (to < 0 || to >= rows.length) return;
    rows[cursor]?.classList.remove('cursor');
    rows[cursor]?.setAttribute('tabindex', '-1');
    cursor = to;
    const row = rows[cursor];
    row.classList.add('cursor');
    row.tabIndex = 0;
    if (focus) {
      row.focus({ preventScroll: true });
      row.scrollIntoView({ block: 'nearest' });
    }
    if (!bar) return;
    head(row);
    strip(row);
    clearTimeout(settle);
    settle = setTimeout(() => ahead(rows[cursor + 1]), 250);
  }

  function apply({ id, outcome, cohort, version, by, at }) {
    const row = byId.get(id);
    if (!row) return;
    Object.assign(row.dataset, { outcome, cohort, version });
    const old = row.querySelector('td .tag:not(.warned)');
    old.className = `tag ${outcome}`;
    old.textContent = outcome;
    row.querySelector('td.cohort').textContent = labelling.visible(cohort);
    row.querySelector('.by').textContent = labelling.visible(by);
    row.querySelector('.at').textContent = at;
    if (row === rows[cursor]) head(row);
  }

  const selected = () => rows.filter((row) => box(row)?.checked).map((row) => ({ id: row.dataset.id }));

  function count() {
    const chosen = selected().length;
    element('selected').hidden = chosen === 0;
    element('count').textContent = `${chosen} selected`;
    const all = element('all');
    all.checked = chosen === rows.length;
    all.indeterminate = chosen > 0 && chosen < rows.length;
  }

  function select(row, on = !box(row).checked) {
    box(row).checked = on;
    lastBox = row;
    count();
  }

  function labelOne(outcome) {
    if (cursor < 0) return void move(0);
    labelling.send([{ id: rows[cursor].dataset.id }], { outcome, reason: '' });
    move(cursor + 1);
  }

  async function labelSelected(outcome) {
    const cohort = element('cohort').value.trim();
    const label = { outcome, reason: element('reason').value.trim(), ...(cohort ? { cohort } : {}) };
    const episodes = selected();
    if (episodes.length && await labelling.send(episodes, label)) {
      rows.forEach((row) => { box(row).checked = false; });
      count();
    }
  }

  function start() {
    labelling.begin({
      task: table.dataset.task,
      find: (id) => {
        const row = byId.get(id);
        const { outcome, cohort, version } = row.dataset;
        return { id, outcome, cohort, version: Number(version), name: row.querySelector('td.name a').textContent };
      },
      apply,
      back: (id) => move(rows.indexOf(byId.get(id))),
    });
    bar.addEventListener('click', ({ target }) => {
      const button = target.closest('[data-label]');
      if (!button) return;
      if (button.dataset.whom === 'selected') labelSelected(button.dataset.label);
      else labelOne(button.dataset.label);
    });
    element('help').addEventListener('click', () => element('keys').showModal());
    element('none').addEventListener('click', () => { rows.forEach((row) => { box(row).checked = false; }); count(); });
    element('all').addEventListener('change', ({ target }) => {
      rows.forEach((row) => { box(row).checked = target.checked; });
      count();
    });
    // With Shift, all boxes from the last one to this one.
    table.addEventListener('click', (event) => {
      const row = event.target.closest('tbody tr');
      if (!row || event.target !== box(row)) return;
      if (event.shiftKey && lastBox) {
        const [from, to] = [rows.indexOf(lastBox), rows.indexOf(row)].sort((a, b) => a - b);
        rows.slice(from, to + 1).forEach((between) => { box(between).checked = event.target.checked; });
      }
      select(row, event.target.checked);
    });
    labelling.keys({
      s: () => labelOne('success'),
      f: () => labelOne('failure'),
      u: () => labelOne('unknown'),
      z: () => { labelling.takeBack(); },
      x: () => (cursor < 0 ? move(0) : select(rows[cursor])),
      '?': () => element('keys').showModal(),
    });
    // Browsers restore boxes on returning to a page.
    count();
  }

  table.addEventListener('click', (event) => {
    const row = event.target.closest('tbody tr');
    if (row && !event.target.closest('a, input')) move(rows.indexOf(row));
  });
  table.addEventListener('focusin', (event) => {
    const row = event.target.closest('tbody tr');
    if (row && rows.indexOf(row) !== cursor) move(rows.indexOf(row), false);
  });
  // Labelled episodes no longer match the filter: this same page then has new ones.
  function turn(which) {
    const { only } = table.dataset;
    const link = document.querySelector(`nav.pages a[rel=${which}]`);
    if (which === 'next' && only && rows.some((row) => row.dataset.outcome !== only)) location.reload();
    else if (link) location.assign(link.href);
  }
  document.querySelector('nav.pages a[rel=next]')?.addEventListener('click', (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    turn('next');
  });
  const next = () => move(cursor + 1);
  const previous = () => move(Math.max(cursor - 1, 0));
  const open = (event) => {
    if (cursor < 0 || event.target.closest('a, button, input, summary')) return false;
    rows[cursor].querySelector('td.name a').click();
    return true;
  };
  labelling.keys({
    j: next, ArrowDown: next, k: previous, ArrowUp: previous, o: open, Enter: open,
    n: () => turn('next'), p: () => turn('prev'),
  });
  if (labels) start();
  if (bar) move(0, false);
})();
