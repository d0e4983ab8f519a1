//! No circles between the modules of a crate, and the floors of the server: every path in the sources is resolved to
//! the module it leads to, and among the files and folders of one folder the paths must lead one way.

use std::collections::{BTreeMap, BTreeSet};

use syn::visit::{self, Visit};

use crate::support::files;

/// The folders of sources of every crate but tests and benches.
fn crates() -> Vec<String> {
    let mut folders = ["client/command", "client", "proto", "server"].map(str::to_owned).to_vec();
    for entry in files::root().join("crates").read_dir().unwrap() {
        folders.push(format!("crates/{}", entry.unwrap().file_name().to_str().unwrap()));
    }
    folders.iter().map(|folder| format!("{folder}/src")).filter(|src| files::root().join(src).is_dir()).collect()
}

/// A module by its path from the root of the crate.
type Module = Vec<String>;

/// Which module a name leads to that another module re-exports.
type Exports = BTreeMap<(Module, String), Module>;

/// The paths that a module names, from the root of its crate.
struct Paths<'a> {
    module: &'a [String],
    modules: &'a BTreeSet<Module>,
    exports: &'a Exports,
    found: BTreeSet<Module>,
}

impl Paths<'_> {
    /// Adds the module that a path leads to; a path of another crate leads nowhere.
    fn add(&mut self, path: &[String]) {
        self.found.extend(self.resolve(path).filter(|at| !at.is_empty()));
    }

    /// Resolves `crate`, `self`, `super`, the module's own children, and re-exports.
    fn resolve(&self, path: &[String]) -> Option<Module> {
        let child = |at: &[String], name: &str| {
            let child = [at, &[name.to_owned()]].concat();
            let exported = self.exports.get(&(at.to_vec(), name.to_owned()));
            self.modules.contains(&child).then_some(child).or_else(|| exported.cloned())
        };
        let mut at: Module = match path.first()?.as_str() {
            "crate" => Vec::new(),
            "self" | "super" => self.module.to_vec(),
            first => child(self.module, first).map(|_| self.module.to_vec())?,
        };
        for part in path.iter().filter(|part| !["crate", "self"].contains(&part.as_str())) {
            if part == "super" {
                at.pop();
                continue;
            }
            match child(&at, part) {
                Some(next) => at = next,
                None => break,
            }
        }
        Some(at)
    }

    fn add_tree(&mut self, before: &[String], tree: &syn::UseTree) {
        match tree {
            syn::UseTree::Path(path) => self.add_tree(&[before, &[path.ident.to_string()]].concat(), &path.tree),
            syn::UseTree::Group(group) => group.items.iter().for_each(|tree| self.add_tree(before, tree)),
            syn::UseTree::Name(name) => self.add(&[before, &[name.ident.to_string()]].concat()),
            syn::UseTree::Rename(name) => self.add(&[before, &[name.ident.to_string()]].concat()),
            syn::UseTree::Glob(_) => self.add(before),
        }
    }
}

/// The names that a `use` gives to paths. Those of a glob are not known.
fn names(before: &[String], tree: &syn::UseTree, found: &mut Vec<(String, Vec<String>)>) {
    let with = |name: &syn::Ident| [before, &[name.to_string()]].concat();
    match tree {
        syn::UseTree::Path(path) => names(&with(&path.ident), &path.tree, found),
        syn::UseTree::Group(group) => group.items.iter().for_each(|tree| names(before, tree, found)),
        syn::UseTree::Name(name) => found.push((name.ident.to_string(), with(&name.ident))),
        syn::UseTree::Rename(name) => found.push((name.rename.to_string(), with(&name.ident))),
        syn::UseTree::Glob(_) => {}
    }
}

/// The names that a `use` of every module brings into it: private ones are for its descendants. Repeated, because one
/// may lead through another.
fn exports(sources: &BTreeMap<Module, syn::File>, modules: &BTreeSet<Module>) -> Exports {
    let mut exports = Exports::new();
    loop {
        let mut next = Exports::new();
        for (module, source) in sources {
            let mut named = Vec::new();
            for item in &source.items {
                if let syn::Item::Use(item) = item {
                    names(&[], &item.tree, &mut named);
                }
            }
            for (name, path) in named {
                let paths = Paths { module, modules, exports: &exports, found: BTreeSet::new() };
                if let Some(at) = paths.resolve(&path).filter(|at| at != module) {
                    next.insert((module.clone(), name), at);
                }
            }
        }
        if next == exports {
            return exports;
        }
        exports = next;
    }
}

fn is_test(attributes: &[syn::Attribute]) -> bool {
    let test = |attribute: &syn::Attribute| match &attribute.meta {
        syn::Meta::List(list) => list.path.is_ident("cfg") && list.tokens.to_string() == "test",
        syn::Meta::Path(_) | syn::Meta::NameValue(_) => false,
    };
    attributes.iter().any(test)
}

impl<'ast> Visit<'ast> for Paths<'_> {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        let test = match item {
            syn::Item::Mod(item) => is_test(&item.attrs),
            syn::Item::Use(item) => is_test(&item.attrs),
            syn::Item::Fn(item) => is_test(&item.attrs),
            syn::Item::Impl(item) => is_test(&item.attrs),
            _ => false,
        };
        if !test {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.add_tree(&[], &item.tree);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        self.add(&path.segments.iter().map(|segment| segment.ident.to_string()).collect::<Vec<_>>());
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, called: &'ast syn::Macro) {
        let text = called.tokens.to_string().replace(" :: ", "::");
        for path in text.split(|c: char| !(c.is_alphanumeric() || "_:".contains(c))).filter(|path| path.contains("::"))
        {
            self.add(&path.split("::").map(str::to_owned).collect::<Vec<_>>());
        }
    }
}

/// The modules of a crate, each with the modules that it names. Tests may name anything.
fn modules(folder: &str) -> BTreeMap<Module, BTreeSet<Module>> {
    let mut sources = BTreeMap::new();
    for path in files::sources(folder, "rs") {
        let (name, source) = files::source(&path);
        let within = name.strip_prefix(folder).unwrap().trim_start_matches('/').trim_end_matches(".rs");
        let mut module: Module = within.split('/').map(str::to_owned).collect();
        if module.iter().any(|part| ["tests", "testing"].contains(&part.as_str())) {
            continue;
        }
        if module.last().is_some_and(|last| ["lib", "main", "mod"].contains(&last.as_str())) {
            module.pop();
        }
        sources.insert(module, syn::parse_file(&source).unwrap());
    }
    let all: BTreeSet<Module> = sources.keys().cloned().collect();
    let exports = exports(&sources, &all);
    let named = sources.iter().map(|(module, source)| {
        let mut paths = Paths { module, modules: &all, exports: &exports, found: BTreeSet::new() };
        paths.visit_file(source);
        (module.clone(), paths.found)
    });
    named.collect()
}

/// The circles among the modules of every folder of a crate, and how many modules it has.
fn circles(folder: &str) -> (usize, Vec<String>) {
    let modules = modules(folder);
    // For each folder, its members and what they lead to among the members.
    let mut graphs: BTreeMap<&[String], BTreeMap<&str, BTreeSet<&str>>> = BTreeMap::new();
    for (from, named) in &modules {
        for to in named {
            let shared = from.iter().zip(to).take_while(|(a, b)| a == b).count();
            if let (Some(a), Some(b)) = (from.get(shared), to.get(shared)) {
                graphs.entry(&from[..shared]).or_default().entry(a).or_default().insert(b);
            }
        }
    }
    let mut found = Vec::new();
    for (parent, graph) in &graphs {
        for from in graph.keys().filter(|from| leads(graph, from, from)) {
            let step = graph[from].iter().find(|to| **to == *from || leads(graph, to, from));
            found.push(format!("{folder}/{}: {from} → {}", parent.join("/"), step.unwrap()));
        }
    }
    (modules.len(), found)
}

/// Whether some way leads from one member to another, or back to itself.
fn leads(graph: &BTreeMap<&str, BTreeSet<&str>>, from: &str, to: &str) -> bool {
    let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(next) = open.pop() {
        open.extend(graph.get(next).into_iter().flatten().filter(|to| reached.insert(**to)));
    }
    reached.contains(to)
}

#[test]
fn modules_have_no_circle() {
    let (mut count, mut found) = (0, Vec::new());
    for folder in crates() {
        let (modules, circles) = circles(&folder);
        count += modules;
        found.extend(circles);
    }
    assert!(count > 400, "the walk found too little: {count} modules");
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// The floors of the server, from the ground: a module may name those of lower floors, and of its own as long as there
/// is no circle.
const FLOORS: [&[&str]; 5] = [
    &["blocking", "config", "model_cache", "program", "shutdown", "telemetry"],
    &["store"],
    &["curation", "imports", "ingest", "jobs", "maintenance", "policies", "rollouts", "scorers"],
    &["access", "connections", "wire"],
    &["openpi", "pages", "service"],
];

#[test]
fn the_floors_of_the_server_hold() {
    let floor = |module: &str| FLOORS.iter().position(|floor| floor.contains(&module));
    let mut broken = Vec::new();
    for (from, named) in modules("server/src").iter().filter(|(module, _)| !module.is_empty()) {
        let Some(own) = floor(&from[0]) else {
            broken.push(format!("{} has no floor", from[0]));
            continue;
        };
        let above = named.iter().filter(|to| floor(&to[0]).is_none_or(|floor| floor > own));
        broken.extend(above.map(|to| format!("{} names {}, which is above it", from.join("::"), to.join("::"))));
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn a_path_is_followed_through_uses_of_uses() {
    let module = |path: &str| path.split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect::<Module>();
    let sources = BTreeMap::from([
        (module(""), syn::parse_file("pub use score::Store;").unwrap()),
        (module("score"), syn::parse_file("pub use features::Store; use features::Hidden;").unwrap()),
        (module("score::features"), syn::parse_file("pub struct Store; pub struct Hidden;").unwrap()),
        (module("score::other"), syn::parse_file("").unwrap()),
    ]);
    let modules: BTreeSet<Module> = sources.keys().cloned().collect();
    let exports = exports(&sources, &modules);
    let from = module("score::other");
    let paths = Paths { module: &from, modules: &modules, exports: &exports, found: BTreeSet::new() };
    let leads_to = |path: &str| paths.resolve(&module(path)).map(|at| at.join("::"));
    assert_eq!(leads_to(&["crate", "Store"].join("::")).unwrap(), "score::features");
    assert_eq!(leads_to("super::Hidden").unwrap(), "score::features");
    assert_eq!(leads_to("super::Store::new").unwrap(), "score::features");
    assert_eq!(leads_to("std::fs"), None);
}
