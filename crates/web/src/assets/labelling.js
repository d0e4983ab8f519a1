'use strict';
// Labels: sends them one after the other, each with the version made by the one before; asks when another person was
// first; undoes the last ones. Both labelling pages load this file first.
const labelling = (() => {
  const proof = document.querySelector('meta[name=proof]')?.content ?? '';
  const messages = document.getElementById('message');
  const undo = document.getElementById('undo');
  const done = [];
  let queue = Promise.resolve();
  let page = { task: '', find: () => null, apply: () => {}, back: () => {} };

  const made = (name, text, more = {}) => Object.assign(document.createElement(name), { textContent: text, ...more });
  const line = messages?.appendChild(made('p', ''));

  // Received text with control and bidirectional characters as visible escapes, as on the server's pages.
  const visible = (text) => String(text ?? '').replace(/[\p{Cc}\p{Cf}\p{Zl}\p{Zp}]/gu,
    (character) => `\\u{${character.codePointAt(0).toString(16)}}`);

  // A success is shown until the next one.
  function say(text) {
    if (line) line.textContent = visible(text);
  }

  // A failure is shown until it is dismissed.
  function warn(text, again) {
    if (!messages) return;
    const note = made('div', '', { className: 'note bad' });
    const leave = made('button', again ? 'Cancel' : 'Dismiss', { type: 'button', className: 'leave' });
    leave.addEventListener('click', () => note.remove());
    note.append(made('p', visible(text)), leave);
    if (again) {
      const button = made('button', again.text, { type: 'button', className: 'again' });
      button.addEventListener('click', () => { note.remove(); again.act(); });
      leave.before(button, ' ');
    }
    messages.append(note);
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
    throw Object.assign(new Error(answer.error ?? `the server responded with status ${response.status}`), { changed: answer.changed });
  }

  const many = (items) => (items.length === 1 ? page.find(items[0].id).name : `${items.length} episodes`);

  // Another person was first: shows their label, and asks.
  function overtaken(items, label, changed) {
    const asked = items.map(({ id }) => page.find(id));
    changed.forEach((one) => page.apply(one));
    const first = changed[0];
    const others = changed.length > 1 ? ` and ${changed.length - 1} more` : '';
    warn(`${first.by || 'Another person'} labelled ${page.find(first.id).name} ${first.outcome} at ${first.at} UTC ` +
      `in the meantime${others}. No label was changed.`,
      { text: `Label ${label.outcome} anyway`, act: () => send(asked, label) });
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

  // Restores the labels of the last labelling, grouped by label.
  function takeBack() {
    queue = queue.then(async () => {
      const last = done.pop();
      if (!last) return say('No labels to undo.');
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
  const press = (which) => () => messages?.querySelector(`.note ${which}`)?.click();

  // Keys that change labels: key repeat is ignored.
  const ONCE = ['s', 'f', 'u', 'z', 'a'];

  // Keyboard actions, except in text fields and with modifiers.
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
