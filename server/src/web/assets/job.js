// Follows a job's course until it has ended, then shows the page anew with what it made.
'use strict';
(() => {
  const ended = ['succeeded', 'failed', 'cancelled'];
  const course = () => document.getElementById('course');
  if (!course()) return;
  let asking = false;

  const refresh = async () => {
    const before = course().dataset.state;
    if (asking || document.hidden || ended.includes(before)) return;
    asking = true;
    try {
      const answer = await fetch(`${location.pathname}/course`, { headers: { accept: 'text/html' } });
      if (!answer.ok || answer.redirected) return;
      const fresh = new DOMParser().parseFromString(await answer.text(), 'text/html').getElementById('course');
      if (!fresh) return;
      if (fresh.dataset.state !== before) {
        location.reload();
        return;
      }
      // Who reads further up in the log is left there.
      const read = document.getElementById('log')?.scrollTop ?? 0;
      course().replaceChildren(...fresh.childNodes);
      document.getElementById('log')?.scrollTo(0, read);
    } catch (_) {
      // The server is away; the next time may have it back.
    } finally {
      asking = false;
    }
  };
  setInterval(refresh, 2000);
  document.addEventListener('visibilitychange', refresh);
})();
