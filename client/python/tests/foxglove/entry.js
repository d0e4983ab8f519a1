// Mounts Foxglove Studio over one recording and one layout, without accounts, extensions and stored settings.
// The state of its player, with the list of problems, is `playerState`.
"use strict";

const LAYOUT = "given";

/** Settings of the app, kept in memory. */
function memorySettings() {
  const values = new Map();
  return {
    get: (key) => values.get(key),
    set: async (key, value) => { values.set(key, value); },
    addChangeListener() {},
    removeChangeListener() {},
  };
}

/** The given layout as the only stored one. */
function memoryLayouts(data) {
  const given = migrateLayout({ id: LAYOUT, name: LAYOUT, permission: "CREATOR_WRITE", baseline: { data } });
  const layouts = new Map([[LAYOUT, given]]);
  return {
    list: async () => [...layouts.values()],
    get: async (namespace, id) => layouts.get(id),
    put: async (namespace, layout) => { layouts.set(layout.id, layout); return layout; },
    delete: async (namespace, id) => { layouts.delete(id); },
    importLayouts: async () => {},
  };
}

/** The app's own source of local MCAP files, over a file that needs no dialog. */
function sourceOf(file) {
  const local = new McapLocalDataSourceFactory();
  const initialize = (given) => {
    const player = local.initialize({ ...given, file });
    const listen = player.setListener.bind(player);
    player.setListener = (listener) => listen((state) => {
      globalThis.playerState = state;
      return listener(state);
    });
    return player;
  };
  const { id, type, displayName, supportedFileTypes } = local;
  return { id, type, displayName, supportedFileTypes, initialize };
}

async function main() {
  const [recording, layout] = await Promise.all(["recording.mcap", "layout.json"].map((name) => fetch(name)));
  const source = sourceOf(new File([await recording.blob()], "recording.mcap"));
  // The app selects the layout of the user's profile, and the source that its address names.
  localStorage.setItem("studio.profile-data", JSON.stringify({ currentLayoutId: LAYOUT }));
  const address = new URL(`?ds=${source.id}`, location.href);
  await initI18n();
  const app = React.createElement(App, {
    deepLinks: [address.href],
    dataSources: [source],
    appConfiguration: memorySettings(),
    layoutStorage: memoryLayouts(await layout.json()),
    extensionLoaders: [],
    enableGlobalCss: true,
  });
  ReactDOM.render(app, document.getElementById("root"));
}

main().catch((error) => console.error(error));
