// Moves the threshold and changes the shape: the histogram at once, the counts as fast as the server answers. One request
// is in flight at a time; the next one takes the newest position of the slider.
'use strict';
(() => {
  const form = document.getElementById('threshold');
  if (!form) return;
  const slider = document.getElementById('slider');
  const number = document.getElementById('beta');
  const trouble = document.getElementById('trouble');
  const make = document.getElementById('make');
  const chosen = document.querySelector('#make [name=beta], #make [name=top_fraction]');
  const shape = Array.from(document.querySelectorAll('#shape input'));
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

  // The fields of the shape that differ from their defaults.
  const changed = () => shape.filter(({ value, dataset }) => value !== '' && Number(value) !== Number(dataset.default));

  let asking = false;
  let wanted = null;
  const ask = async () => {
    if (asking || wanted === null) return;
    asking = true;
    const beta = wanted;
    wanted = null;
    try {
      const query = new URLSearchParams(location.search);
      if (beta !== '') {
        query.delete('top_fraction');
        query.set('beta', beta);
      }
      for (const { name } of shape) query.delete(name);
      for (const { name, value } of changed()) query.set(name, value);
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

  // The dataset has the shape of the counts.
  const reshape = () => {
    const wrong = shape.find((field) => !field.checkValidity());
    if (wrong) {
      showError(`${wrong.name}: ${wrong.validationMessage}`);
      return;
    }
    if (make) {
      for (const { name } of shape) make.querySelector(`[name=${name}]`)?.remove();
      for (const { name, value } of changed()) {
        const hidden = document.createElement('input');
        [hidden.type, hidden.name, hidden.value] = ['hidden', name, value];
        make.append(hidden);
      }
    }
    wanted = number.value;
    ask();
  };
  for (const field of shape) field.addEventListener('input', reshape);
  slider.addEventListener('input', () => move(slider.value, number));
  number.addEventListener('input', () => move(number.value, slider));
  form.addEventListener('submit', (event) => {
    event.preventDefault();
    move(number.value, slider);
  });
})();
