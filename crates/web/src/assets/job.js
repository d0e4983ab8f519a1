// Refreshes a job's progress and log until it ends, then reloads the page with its result.
'use strict';
(() => {
  const ended = ['succeeded', 'failed', 'cancelled'];
  const course = () => document.getElementById('course');
  if (!course()) return;
  let asking = false;
  // The last lines of its workers may arrive after its end.
  let afterwards = 2;

  // Lines are added while a person may be reading: selection, focus and scroll position are kept.
  const listen = (fresh) => {
    const section = document.getElementById('log-section');
    const [lines, more] = [section, fresh].map((part) => part.querySelector('pre'));
    if (!lines || !more) {
      if (section.textContent !== fresh.textContent) section.replaceChildren(...fresh.childNodes);
      return;
    }
    const selection = document.getSelection();
    const held = !selection.isCollapsed && lines.contains(selection.anchorNode);
    if (held || lines.textContent === more.textContent) return;
    const log = lines.parentElement;
    const { scrollTop, scrollHeight } = log;
    lines.textContent = more.textContent;
    // Scrolled from its end: 0 is the newest line.
    if (scrollTop < 0) log.scrollTop = scrollTop - (log.scrollHeight - scrollHeight);
  };

  const refresh = async () => {
    const before = course().dataset.state;
    if (asking || document.hidden || (ended.includes(before) && afterwards-- <= 0)) return;
    asking = true;
    try {
      const answer = await fetch(`${location.pathname}/course`, { headers: { accept: 'text/html' } });
      if (!answer.ok || answer.redirected) return;
      const parts = new DOMParser().parseFromString(await answer.text(), 'text/html');
      const [fresh, section] = ['course', 'log-section'].map((id) => parts.getElementById(id));
      if (!fresh || !section) return;
      if (fresh.dataset.state !== before) {
        location.reload();
        return;
      }
      listen(section);
      if (!ended.includes(before)) course().replaceChildren(...fresh.childNodes);
    } catch (_) {
      // The server is unreachable; the next refresh retries.
    } finally {
      asking = false;
    }
  };
  setInterval(refresh, 2000);
  document.addEventListener('visibilitychange', refresh);
})();
