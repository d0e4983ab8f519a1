// Refreshes the list of jobs while one of them runs or waits: changed rows are replaced.
'use strict';
(() => {
  const list = document.getElementById('jobs');
  if (!list) return;
  let asking = false;

  const refresh = async () => {
    if (asking || document.hidden || !('live' in list.dataset)) return;
    asking = true;
    try {
      const answer = await fetch(location.href, { headers: { accept: 'text/html' } });
      if (!answer.ok || answer.redirected) return;
      const fresh = new DOMParser().parseFromString(await answer.text(), 'text/html').getElementById('jobs');
      if (!fresh) return;
      const rows = Array.from(fresh.rows);
      rows.forEach((row, place) => {
        const old = document.getElementById(row.id);
        // An unchanged row stays, and so does the focus in it.
        const kept = old && old.innerHTML === row.innerHTML ? old : row;
        if (old && kept !== old && old.contains(document.activeElement)) {
          old.replaceWith(row);
          row.querySelector('a.id')?.focus();
        }
        if (list.rows[place] !== kept) {
          if (old && kept !== old) old.remove();
          list.insertBefore(kept, list.rows[place] ?? null);
        }
      });
      while (list.rows.length > rows.length) list.deleteRow(-1);
      if (!('live' in fresh.dataset)) delete list.dataset.live;
    } catch (_) {
      // The server is unreachable; the next refresh retries.
    } finally {
      asking = false;
    }
  };
  setInterval(refresh, 2000);
  document.addEventListener('visibilitychange', refresh);
})();
