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

  const ELEMENT = (name, text, more = {}) => Object.assign(document.createElement(name), { textContent: text, ...more });

  function say(text, bad = false, ...more) {
    if (!told) return;
    told.className = bad ? 'note bad' : '';
    told.replaceChildren(ELEMENT('span', text), ...more);
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
    const again = ELEMENT('button', `Label ${label.outcome} all the same`, { type: 'button' });
    const leave = ELEMENT('button', 'Leave it', { type: 'button' });
    again.addEventListener('click', () => send(asked, label));
    leave.addEventListener('click', () => say('Left as it is.'));
    say(`${first.by || 'Somebody'} labelled ${page.find(first.id).name} ${first.outcome} at ${first.at} UTC meanwhile${others}. ` +
      'Nothing was changed. ', true, again, ' ', leave);
    again.focus();
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
      else if (error instanceof TypeError) say(`The server cannot be reached; ${name} was not labelled.`, true);
      else say(`${name} was not labelled: ${error.message}`, true);
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
      for (const group of alike.values()) {
        const { outcome, cohort } = group[0];
        if (!await attempt(group, { outcome, cohort, reason: 'undone' }, true)) return;
      }
      page.back(last[0].id);
    });
    return queue;
  }

  undo?.addEventListener('click', takeBack);

  // What keys do, unless somebody writes or holds a modifier.
  function keys(handlers) {
    document.addEventListener('keydown', (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector('dialog[open]')) return;
      const inside = event.target.closest('input:not([type=checkbox], [type=range]), select, textarea');
      const pressed = event.key.length === 1 ? event.key.toLowerCase() : event.key;
      const handler = handlers[pressed];
      if (inside || !handler || handler(event) === false) return;
      event.preventDefault();
    });
  }

  return { begin: (given) => { page = given; }, send, takeBack, keys, say };
})();
