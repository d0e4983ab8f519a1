//! The reference of every key of a task file, generated from the definition of the specification.

use std::fmt::Write as _;

use syn::{Attribute, Fields, Item, ItemEnum, ItemStruct, Type};

use crate::support::files::root;

/// Set to write the reference instead of comparing it (`make task-file`).
const WRITE: &str = "GLEANER_WRITE_TASK_REFERENCE";

const HEAD: &str = "# Keys of a task file\n\n\
    A task file is TOML, or JSON with the same keys. `gleaner task draft` writes one from recordings, `gleaner task check` \
    checks one, and `examples/pick_cube_maniskill.toml` is a whole one.\n\
    This page is generated from the definition (`make task-file`).\n";

/// The items of the files that define the specification.
fn items() -> Vec<Item> {
    let files = ["task_spec.rs", "picture_sizes.rs"];
    let parse = |name: &str| {
        let text = std::fs::read_to_string(root().join("crates/core/src").join(name)).unwrap();
        syn::parse_file(&text).unwrap().items
    };
    files.into_iter().flat_map(parse).collect()
}

fn doc(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter_map(|attribute| match &attribute.meta {
        syn::Meta::NameValue(pair) if pair.path.is_ident("doc") => match &pair.value {
            syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(text), .. }) => Some(text.value().trim().to_owned()),
            _ => None,
        },
        _ => None,
    });
    lines.collect::<Vec<_>>().join(" ")
}

/// Whether serde fills in a missing key, and by which function.
fn default(attributes: &[Attribute]) -> Option<Option<String>> {
    let mut found = None;
    for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("serde")) {
        attribute
            .parse_nested_meta(|meta| {
                let value = meta.value().ok().map(|value| value.parse::<syn::LitStr>()).transpose()?;
                if meta.path.is_ident("default") {
                    found = Some(value.map(|value| value.value()));
                }
                Ok(())
            })
            .unwrap();
    }
    found
}

/// The name of a type, and whether it is a list.
fn named(kind: &Type) -> (String, bool) {
    let Type::Path(path) = kind else { panic!("a key has no type with a path") };
    let last = path.path.segments.last().unwrap();
    let inner = match &last.arguments {
        syn::PathArguments::AngleBracketed(arguments) => match arguments.args.first() {
            Some(syn::GenericArgument::Type(inner)) => Some(named(inner)),
            _ => None,
        },
        _ => None,
    };
    match (last.ident.to_string().as_str(), inner) {
        ("Vec", Some((inner, _))) => (inner, true),
        ("Option", Some(inner)) => inner,
        (name, _) => (name.to_owned(), false),
    }
}

fn snake(name: &str) -> String {
    let mut snake = String::new();
    for c in name.chars() {
        if c.is_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.extend(c.to_lowercase());
    }
    snake
}

/// Describes one table and, after it, the tables within it.
fn table(items: &[Item], of: &str, heading: &str, path: &str, text: &mut String) {
    let found = |item: &Item| matches!(item, Item::Struct(found) if found.ident == of);
    let Some(Item::Struct(ItemStruct { attrs, fields: Fields::Named(fields), .. })) =
        items.iter().find(|item| found(item))
    else {
        panic!("{of} is not a struct of the specification");
    };
    write!(text, "\n## {heading}\n\n{}\n\n", doc(attrs)).unwrap();
    let mut inner = Vec::new();
    for field in &fields.named {
        let name = field.ident.as_ref().unwrap().to_string();
        let (kind, list) = named(&field.ty);
        let is_struct = items.iter().any(|item| matches!(item, Item::Struct(found) if found.ident == kind));
        let choice = items.iter().find_map(|item| match item {
            Item::Enum(found) if found.ident == kind => Some(found),
            _ => None,
        });
        let word = match (kind.as_str(), choice) {
            ("String", _) => "text".to_owned(),
            ("f64" | "f32", _) => "number".to_owned(),
            ("Bound", _) => "number, or list of numbers".to_owned(),
            ("u32", _) => "whole number".to_owned(),
            ("bool", _) => "true or false".to_owned(),
            (_, Some(choice)) => words(choice),
            _ => "table".to_owned(),
        };
        let word = if list { format!("list of {}", if is_struct { "tables" } else { &word }) } else { word };
        let given = match default(&field.attrs) {
            None => "required",
            Some(None) => "optional",
            Some(Some(function)) => &format!("default {}", returned(items, &function)),
        };
        writeln!(text, "- `{name}` ({word}, {given}): {}", doc(&field.attrs)).unwrap();
        if is_struct {
            let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
            let heading = if list { format!("`[[{path}]]`") } else { format!("`{path} = {{ … }}`") };
            inner.push((kind, heading, path));
        }
    }
    for (kind, heading, path) in inner {
        // The definition of both lists of fields is one.
        if path == "action" {
            writeln!(text, "\n## {heading}\n\nIt has the keys of `[[proprioception]]`.").unwrap();
        } else {
            table(items, &kind, &heading, &path, text);
        }
    }
}

/// The words of a choice; the default is marked.
fn words(choice: &ItemEnum) -> String {
    let word = |variant: &syn::Variant| {
        let standard = variant.attrs.iter().any(|attribute| attribute.path().is_ident("default"));
        format!("\"{}\"{}", snake(&variant.ident.to_string()), if standard { " by default" } else { "" })
    };
    choice.variants.iter().map(word).collect::<Vec<_>>().join(" or ")
}

/// The number or text that a function without arguments returns.
fn returned(items: &[Item], function: &str) -> String {
    let body = items.iter().find_map(|item| match item {
        Item::Fn(found) if found.sig.ident == function => found.block.stmts.first(),
        _ => None,
    });
    match body {
        Some(syn::Stmt::Expr(syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Float(number), .. }), _)) => {
            number.to_string()
        }
        Some(syn::Stmt::Expr(syn::Expr::MethodCall(call), _)) => match &*call.receiver {
            syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(text), .. }) => format!("`{}`", text.value()),
            _ => panic!("{function} does not return a text"),
        },
        _ => panic!("{function} does not return a number or a text"),
    }
}

#[test]
fn reference_of_task_files_is_that_of_the_definition() {
    let mut text = HEAD.to_owned();
    table(&items(), "TaskSpec", "The file", "", &mut text);
    let path = root().join("docs/task-file.md");
    if std::env::var_os(WRITE).is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let present = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(present == text, "docs/task-file.md is not that of the definition: run `make task-file`");
    for part in ["`tolerance` (number, default 0.25)", "## `[[mappings.fields]]`", "\"latest_before\" by default"] {
        assert!(text.contains(part), "{part}: {text}");
    }
}
