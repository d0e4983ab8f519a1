// Follows a job's course and log until it has ended, then shows the page anew with what it made.
'use strict';
(() => {
  const ended = ['succeeded', 'failed', 'cancelled'];
  const course = () => document.getElementById('course');
  if (!course()) return;
  let asking = false;
  // The last words of its workers may come after its end.
  let afterwards = 2;

  // Lines come where somebody may be reading: what is selected, focused or scrolled to stays as it is.
  const listen = (fresh) => {
    const said = document.getElementById('said');
    const [lines, more] = [said, fresh].map((part) => part.querySelector('pre'));
    if (!lines || !more) {
      if (said.textContent !== fresh.textContent) said.replaceChildren(...fresh.childNodes);
      return;
    }
    const selection = document.getSelection();
    const held = !selection.isCollapsed && lines.contains(selection.anchorNode);
    if (held || lines.textContent === more.textContent) return;
    const log = lines.parentElement;
    const { scrollTop, scrollHeight } = log;
    lines.textContent = more.textContent;
    // It is scrolled from its end: 0 is the newest line, and stays it.
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
      const [fresh, said] = ['course', 'said'].map((id) => parts.getElementById(id));
      if (!fresh || !said) return;
      if (fresh.dataset.state !== before) {
        location.reload();
        return;
      }
      listen(said);
      if (!ended.includes(before)) course().replaceChildren(...fresh.childNodes);
    } catch (_) {
      // The server is away; the next time may have it back.
    } finally {
      asking = false;
    }
  };
  setInterval(refresh, 2000);
  document.addEventListener('visibilitychange', refresh);
})();
