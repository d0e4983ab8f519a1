// Refreshes a part of a page each second while the page is visible.
'use strict';
(() => {
  const part = document.getElementById('live');
  if (!part) return;
  let asking = false;
  const refresh = async () => {
    if (asking || document.hidden) return;
    asking = true;
    try {
      const answer = await fetch(part.dataset.from, { headers: { accept: 'text/html' } });
      if (answer.ok && !answer.redirected) part.innerHTML = await answer.text();
    } catch (_) {
      // The server is unreachable; the next second retries.
    } finally {
      asking = false;
    }
  };
  setInterval(refresh, 1000);
})();
