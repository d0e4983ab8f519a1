'use strict';
// Labels: sends them one after the other, so that each is sent with the version that the one before has made; tells who
// was first when somebody else was; takes the last ones back. Both pages that label begin with this file.
const labelling = (() => {
  const proof = document.querySelector('meta[name=proof]')?.content ?? '';
  const told = document.getElementById('told');
  const undo = document.getElementById('undo');
  const done = [];
  let queue = Promise.resolve();
  let page = { task: '', find: () => null, apply: () => {}, back: () => {} };

  const made = (name, text, more = {}) => Object.assign(document.createElement(name), { textContent: text, ...more });
  const line = told?.appendChild(made('p', ''));

  // Text from elsewhere as the server's pages show it: control and bidirectional characters as visible escapes.
  const visible = (text) => String(text ?? '').replace(/[\p{Cc}\p{Cf}\p{Zl}\p{Zp}]/gu,
    (character) => `\\u{${character.codePointAt(0).toString(16)}}`);

  // What went well is said until the next does.
  function say(text) {
    if (line) line.textContent = visible(text);
  }

  // What did not stays until somebody has seen it.
  function warn(text, again) {
    if (!told) return;
    const note = made('div', '', { className: 'note bad' });
    const leave = made('button', again ? 'Leave it' : 'Dismiss', { type: 'button', className: 'leave' });
    leave.addEventListener('click', () => note.remove());
    note.append(made('p', visible(text)), leave);
    if (again) {
      const button = made('button', again.said, { type: 'button', className: 'again' });
      button.addEventListener('click', () => { note.remove(); again.act(); });
      leave.before(button, ' ');
    }
    told.append(note);
  }

  async function post(items, label) {
    const episodes = items.map(({ id }) => ({ id, version: page.find(id).version }));
    const response = await fetch(`/tasks/${encodeURIComponent(page.task)}/labels`, {
      method: 'POST',
      headers: { 'content-type': 'application/json', accept: 'application/json', 'x-gleaner-proof': proof },
      body: JSON.stringify({ episodes, ...label }),
    });
    const answer = await response.json().catch(() => ({}));
    if (response.ok) return answer.episodes;
    throw Object.assign(new Error(answer.error ?? `the server answered ${response.status}`), { changed: answer.changed });
  }

  const many = (items) => (items.length === 1 ? page.find(items[0].id).name : `${items.length} episodes`);

  // Somebody else was first: shows what they said, and asks.
  function overtaken(items, label, changed) {
    const asked = items.map(({ id }) => page.find(id));
    changed.forEach((one) => page.apply(one));
    const first = changed[0];
    const others = changed.length > 1 ? ` and ${changed.length - 1} more` : '';
    warn(`${first.by || 'Somebody'} labelled ${page.find(first.id).name} ${first.outcome} at ${first.at} UTC ` +
      `meanwhile${others}. Nothing was changed.`,
      { said: `Label ${label.outcome} all the same`, act: () => send(asked, label) });
  }

  async function attempt(items, label, undoing) {
    const before = items.map(({ id }) => page.find(id)).map(({ id, outcome, cohort }) => ({ id, outcome, cohort }));
    const name = many(items);
    try {
      const rows = await post(items, label);
      rows.forEach((row) => page.apply({ ...row, reason: label.reason }));
      if (!undoing) done.push(before);
      say(`${name}: ${undoing ? 'back to ' : ''}${label.outcome}.`);
      return true;
    } catch (error) {
      if (error.changed) overtaken(items, label, error.changed);
      else if (error instanceof TypeError) warn(`The server cannot be reached; ${name} was not labelled.`);
      else warn(`${name} was not labelled: ${error.message}`);
      return false;
    } finally {
      if (undo) undo.disabled = done.length === 0;
    }
  }

  // Labels each of the items ({id}); resolves when the server has answered.
  function send(items, label) {
    queue = queue.then(() => attempt(items, label, false));
    return queue;
  }

  // Labels the episodes of the last labelling back to what they were, those that were alike together.
  function takeBack() {
    queue = queue.then(async () => {
      const last = done.pop();
      if (!last) return say('There is nothing to undo.');
      const alike = new Map();
      last.forEach((one) => {
        const key = JSON.stringify([one.outcome, one.cohort]);
        alike.set(key, [...(alike.get(key) ?? []), one]);
      });
      const groups = [...alike.values()];
      while (groups.length) {
        const { outcome, cohort } = groups[0][0];
        if (!await attempt(groups[0], { outcome, cohort, reason: 'undone' }, true)) {
          done.push(groups.flat());
          undo.disabled = false;
          return;
        }
        groups.shift();
      }
      page.back(last[0].id);
    });
    return queue;
  }

  undo?.addEventListener('click', takeBack);
  const press = (which) => () => told?.querySelector(`.note ${which}`)?.click();

  // Keys that change labels: one that is held down changes one.
  const ONCE = ['s', 'f', 'u', 'z', 'a'];

  // What keys do, unless somebody writes or holds a modifier.
  function keys(handlers) {
    document.addEventListener('keydown', (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector('dialog[open]')) return;
      const inside = event.target.closest('input:not([type=checkbox], [type=range]), select, textarea');
      const pressed = event.key.length === 1 ? event.key.toLowerCase() : event.key;
      const handler = event.repeat && ONCE.includes(pressed) ? null : handlers[pressed];
      if (inside || !handler || handler(event) === false) return;
      event.preventDefault();
    });
  }

  keys({ a: press('.again'), Escape: press('.leave') });

  return { begin: (given) => { page = given; }, send, takeBack, keys, warn, visible };
})();
