// Keeps a part of a page fresh: asks for it again each second while somebody looks, and puts it in whole.
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
      // The server is away; the next second may have it back.
    } finally {
      asking = false;
    }
  };
  setInterval(refresh, 1000);
})();
