// Moves the threshold: the histogram at once, the counts as fast as the server answers. One request is in flight at a
// time; the next one takes the newest position of the slider.
'use strict';
(() => {
  const form = document.getElementById('threshold');
  if (!form) return;
  const slider = document.getElementById('slider');
  const number = document.getElementById('beta');
  const trouble = document.getElementById('trouble');
  const chosen = document.querySelector('#make [name=beta], #make [name=top_fraction]');
  const picture = document.querySelector('.threshold svg.plot');
  const bars = Array.from(picture.querySelectorAll('rect.q'));
  const follows = ['counts', 'by-cohort', 'by-episode'];
  form.querySelector('button').hidden = true;

  const line = () => {
    let line = picture.querySelector('line.beta');
    if (!line) {
      line = document.createElementNS('http://www.w3.org/2000/svg', 'line');
      line.setAttribute('class', 'beta');
      line.setAttribute('y1', picture.dataset.bottom);
      line.setAttribute('y2', picture.dataset.top);
      picture.append(line);
    }
    return line;
  };

  const draw = (beta) => {
    bars.forEach((bar, place) => bar.classList.toggle('kept', place / bars.length >= beta - 1e-9));
    const { left, right, from, to } = picture.dataset;
    const x = +left + ((beta - from) / (to - from)) * (right - left);
    for (const end of ['x1', 'x2']) line().setAttribute(end, x);
  };

  const showError = (text) => {
    trouble.textContent = text;
    trouble.hidden = !text;
  };

  let asking = false;
  let wanted = null;
  const ask = async () => {
    if (asking || wanted === null) return;
    asking = true;
    const beta = wanted;
    wanted = null;
    try {
      const query = new URLSearchParams(location.search);
      query.delete('top_fraction');
      query.set('beta', beta);
      query.set('format', 'html');
      const answer = await fetch(`/runs/${form.dataset.run}/what-if?${query}`, { headers: { accept: 'application/json' } });
      if (!answer.ok) throw new Error((await answer.json()).error);
      const fresh = new DOMParser().parseFromString(await answer.text(), 'text/html');
      for (const id of follows) {
        document.getElementById(id).replaceChildren(...fresh.getElementById(id).childNodes);
      }
      query.delete('format');
      history.replaceState(null, '', `?${query}`);
      showError('');
    } catch (error) {
      showError(error.message || 'The server cannot be reached.');
    } finally {
      asking = false;
      ask();
    }
  };

  const move = (text, other) => {
    const beta = Number(text);
    if (text.trim() === '' || !(beta >= 0 && beta <= 1)) {
      showError('β must be a number between 0 and 1.');
      return;
    }
    other.value = beta;
    draw(beta);
    if (chosen) [chosen.name, chosen.value] = ['beta', beta];
    wanted = String(beta);
    ask();
  };
  slider.addEventListener('input', () => move(slider.value, number));
  number.addEventListener('input', () => move(number.value, slider));
  form.addEventListener('submit', (event) => {
    event.preventDefault();
    move(number.value, slider);
  });
})();
