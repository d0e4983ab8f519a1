// One episode: steps and plays its cameras, the cursor in its plots and the matched expert; labels.
(() => {
  const about = JSON.parse(document.getElementById('episode').textContent);
  const element = (id) => document.getElementById(id);
  const SVG = 'http://www.w3.org/2000/svg';
  const { times } = about;
  const last = Math.max(about.steps - 1, 0);
  const cameras = [...document.querySelectorAll('img[data-before]')];
  const experts = [...document.querySelectorAll('img[data-match]')];
  const plots = [...document.querySelectorAll('.timeline svg.plot')];
  let step = about.step;
  let beta = about.beta;
  let scores = null;

  // Images, a few requests at a time: the shown ones first, then the next ones.
  const AT_ONCE = 4;
  const KEPT = 900;
  const kept = new Map();
  let coming = 0;
  let wishes = [];
  function fetchMore() {
    while (coming < AT_ONCE && wishes.length) {
      const url = wishes.shift();
      if (kept.has(url)) continue;
      const image = new Image();
      kept.set(url, image);
      if (kept.size > KEPT) kept.delete(kept.keys().next().value);
      coming += 1;
      image.onload = image.onerror = () => { coming -= 1; show(); fetchMore(); };
      image.src = url;
    }
  }
  const here = (url) => kept.get(url)?.complete ?? false;
  const picture = (image, at) => `${image.dataset.before}${at}${image.dataset.after}`;

  function wish() {
    const ahead = playing ? 24 : 3;
    const steps = Array.from({ length: ahead + 1 }, (_, n) => step + n).filter((at) => at <= last);
    const seen = (at) => cameras.map((image) => picture(image, at));
    wishes = [...seen(step), ...matched().map(([, url]) => url), ...steps.slice(1).flatMap(seen)].filter((url) => !kept.has(url));
    fetchMore();
  }

  // The expert's images at the matched step. A permanently deleted expert has no images and no page.
  const deleted = ({ expert }) => about.deleted.includes(expert);
  function match() {
    const expert = scores?.experts[scores.match_episode[step]];
    return expert && { expert, at: scores.match_step[step], distances: scores.distances[step] };
  }
  function matched() {
    const found = match();
    if (!found || deleted(found)) return [];
    return experts.map((image) =>
      [image, `/episodes/${found.expert}/frames/${encodeURIComponent(image.dataset.match)}/${found.at}`]);
  }

  function put(image, url) {
    if (here(url) && image.getAttribute('src') !== url) image.src = url;
  }
  function show() {
    cameras.forEach((image) => put(image, picture(image, step)));
    matched().forEach(([image, url]) => put(image, url));
  }

  // Plots: a cursor in each, and the time of a position in one.
  const scale = ({ dataset }) => ({
    left: Number(dataset.left), right: Number(dataset.right), from: Number(dataset.from), to: Number(dataset.to),
    top: Number(dataset.top), bottom: Number(dataset.bottom),
  });
  const line = (svg) => {
    const { top, bottom } = scale(svg);
    const cursor = document.createElementNS(SVG, 'line');
    Object.entries({ class: 'cursor', y1: top, y2: bottom }).forEach(([name, value]) => cursor.setAttribute(name, value));
    return svg.appendChild(cursor);
  };
  const cursors = plots.map((svg) => [svg, line(svg)]);
  const across = (svg, time) => {
    const { left, right, from, to } = scale(svg);
    return left + (time - from) / (to - from) * (right - left);
  };
  function nearest(time) {
    let [low, high] = [0, last];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] < time) low = middle + 1; else high = middle;
    }
    return low > 0 && time - times[low - 1] < times[low] - time ? low - 1 : low;
  }
  function seek(event) {
    const svg = event.currentTarget;
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const { left, right, from, to } = scale(svg);
    pause();
    go(nearest(from + (point.x - left) / (right - left) * (to - from)));
  }
  plots.forEach((svg) => {
    svg.addEventListener('pointerdown', (event) => { svg.setPointerCapture(event.pointerId); seek(event); });
    svg.addEventListener('pointermove', (event) => { if (event.buttons & 1) seek(event); });
  });

  // The address contains the view, so that it can be shared.
  let writing = 0;
  function address() {
    clearTimeout(writing);
    writing = setTimeout(() => {
      const url = new URL(location.href);
      url.searchParams.set('step', step);
      if (about.run) url.searchParams.set('run', about.run);
      if (about.run) url.searchParams.set('beta', beta);
      history.replaceState(null, '', url);
      const hidden = document.querySelector('form.choose input[name=step]');
      if (hidden) hidden.value = step;
    }, 300);
  }

  function readMatch() {
    const found = match();
    const q = scores?.q[step];
    if (element('q-here')) element('q-here').textContent = q == null ? '–' : q.toFixed(3);
    if (!found || !element('match')) return;
    const link = element('match-link');
    if (deleted(found)) link.removeAttribute('href');
    else link.href = `/episodes/${found.expert}?step=${found.at}&run=${about.run}`;
    element('match-deleted').hidden = !deleted(found);
    experts.forEach((image) => { image.hidden = deleted(found); });
    link.textContent = `${found.expert.split('_')[0]}…${found.expert.slice(-8)} at step ${found.at}`;
    ['o', 'm', 'a'].forEach((name, place) => {
      document.querySelector(`[data-distance=${name}]`).textContent = found.distances[place]?.toFixed(3) ?? '–';
    });
  }

  function go(to) {
    step = Math.min(Math.max(to, 0), last);
    element('step').value = step;
    const q = scores?.q[step];
    element('at').textContent = `step ${step} of ${last} · ${times[step].toFixed(2)} s${q == null ? '' : ` · q ${q.toFixed(3)}`}`;
    cursors.forEach(([svg, cursor]) => {
      const x = across(svg, times[step]);
      cursor.setAttribute('x1', x);
      cursor.setAttribute('x2', x);
    });
    readMatch();
    show();
    wish();
    if (!playing) address();
  }

  // Plays at the recorded speed; waits for late images.
  let playing = null;
  const button = element('play');
  function pause() {
    if (!playing) return;
    playing = null;
    button.textContent = 'Play';
    button.setAttribute('aria-pressed', 'false');
    address();
  }
  function play() {
    const begin = step >= last ? 0 : step;
    playing = { since: performance.now(), from: times[begin] };
    button.textContent = 'Pause';
    button.setAttribute('aria-pressed', 'true');
    go(begin);
    requestAnimationFrame(tick);
  }
  function tick(now) {
    if (!playing) return;
    const time = playing.from + (now - playing.since) / 1000;
    let to = step;
    while (to < last && times[to + 1] <= time && cameras.every((image) => here(picture(image, to + 1)))) to += 1;
    if (to < last && times[to + 1] <= time) playing = { since: now, from: times[to] };
    if (to !== step) go(to);
    if (step >= last) pause(); else requestAnimationFrame(tick);
  }
  const toggle = () => (playing ? pause() : play());
  button.addEventListener('click', toggle);
  element('step').addEventListener('input', ({ target }) => { pause(); go(Number(target.value)); });
  document.addEventListener('click', (event) => {
    const link = event.target.closest('a[data-step]');
    if (!link) return;
    event.preventDefault();
    pause();
    go(Number(link.dataset.step));
    element('step').scrollIntoView({ block: 'nearest' });
  });

  // β: its line, the segments above it, and their number.
  function threshold(value) {
    beta = value;
    const svg = element('level')?.ownerSVGElement;
    if (!svg || !scores) return;
    const { top, bottom } = scale(svg);
    const y = bottom - beta * (bottom - top);
    element('level').querySelector('line').setAttribute('y1', y);
    element('level').querySelector('line').setAttribute('y2', y);
    const above = scores.q.map((q) => q > Math.fround(beta));
    const time = (at) => times[Math.min(Math.max(at, 0), last)];
    const shades = [];
    above.forEach((keep, at) => {
      if (!keep) return;
      if (at > 0 && above[at - 1]) { shades[shades.length - 1][1] = at; return; }
      shades.push([at, at]);
    });
    element('shades').replaceChildren(...shades.map(([first, end]) => {
      const [left, right] = [(time(first - 1) + time(first)) / 2, (time(end) + time(end + 1)) / 2].map((at) => across(svg, at));
      const shade = document.createElementNS(SVG, 'rect');
      const place = { class: 'shade', x: left, y: top, width: Math.max(right - left, 0.6), height: bottom - top };
      Object.entries(place).forEach(([name, given]) => shade.setAttribute(name, given));
      return shade;
    }));
    const [count, of] = [above.filter(Boolean).length, above.length];
    // A run keeps every segment of its experts.
    if (element('kept')) element('kept').textContent = `${count} of ${of} segments kept (${(100 * count / Math.max(of, 1)).toFixed(1)} %)`;
    address();
  }
  [['beta', 'beta-number'], ['beta-number', 'beta']].forEach(([from, to]) => {
    element(from)?.addEventListener('input', ({ target }) => {
      const value = Number(target.value);
      if (target.value === '' || !(value >= 0 && value <= 1)) return;
      element(to).value = target.value;
      threshold(value);
    });
  });
  if (element('choose')) element('choose').hidden = true;
  element('run')?.addEventListener('change', ({ target }) => target.form.requestSubmit());

  // Labels.
  const name = document.querySelector('h1').textContent;
  labelling.begin({
    task: about.task,
    find: () => ({ ...about, name }),
    apply: ({ outcome, cohort, version, by, at, reason }) => {
      Object.assign(about, { outcome, cohort, version });
      Object.assign(element('outcome'), { className: `tag ${outcome}`, textContent: outcome });
      const [item, tag, rest] = ['li', 'span', 'span'].map((kind) => document.createElement(kind));
      Object.assign(tag, { className: `tag ${outcome}`, textContent: outcome });
      Object.assign(rest, { className: 'soft', textContent: ` ${labelling.visible(cohort)} by ${labelling.visible(by)}, ${at} UTC` });
      item.append(tag, rest, ...(reason ? [document.createElement('br'), `“${labelling.visible(reason)}”`] : []));
      element('labels').prepend(item);
      // A refused label keeps its reason in the field.
      if (reason && element('reason').value.trim() === reason) element('reason').value = '';
    },
    back: () => {},
  });
  const label = (outcome) => {
    labelling.send([{ id: about.id }], { outcome, reason: element('reason').value.trim() });
  };
  document.querySelectorAll('[data-label]').forEach((one) =>
    one.addEventListener('click', () => label(one.dataset.label)));

  const by = (steps) => ({ target, shiftKey }) => {
    if (target.id === 'beta') return false;
    pause();
    go(step + steps * (shiftKey ? 10 : 1));
    return true;
  };
  labelling.keys({
    ' ': ({ target }) => (target.closest('button, a, summary') ? false : toggle()),
    ArrowLeft: by(-1),
    ArrowRight: by(1),
    ...(about.labels
      ? { s: () => label('success'), f: () => label('failure'), u: () => label('unknown'), z: () => { labelling.takeBack(); } }
      : {}),
  });

  go(step);
  if (about.run) {
    fetch(`/episodes/${about.id}/scores.json?run=${about.run}`, { headers: { accept: 'application/json' } })
      .then((response) => (response.ok ? response.json() : Promise.reject(new Error(response.statusText))))
      .then((answer) => { scores = answer; go(step); })
      .catch((error) => labelling.warn(`The scores could not be loaded: ${error.message}`));
  }
})();
