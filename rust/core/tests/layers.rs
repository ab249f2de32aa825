//! What holds of all modules. Each imports only what stands above it in its parent's table, and no imports run in a circle.
//!
//! Tables stand in the documentation of lib.rs and of the folders' modules. Tests may import what they like.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// A module's path without the crate: "surface::mesh"; lib.rs is "".
type Name = String;

/// An import: the place in the sources, for messages, and the module that it leads to.
struct Import {
    at: String,
    to: Name,
}

/// A module's sources and what is read out of them.
struct Module {
    file: String,
    text: String,
}

/// All modules but those of tests.
fn modules() -> BTreeMap<Name, Module> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let (mut modules, mut folders) = (BTreeMap::new(), vec![root.clone()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let file = path.strip_prefix(&root).unwrap().to_str().unwrap().replace('\\', "/");
            let name = file.trim_end_matches(".rs").replace('/', "::");
            if name == "tests" || name.contains("::tests") {
                continue;
            }
            let name = if name == "lib" { "" } else { name.trim_end_matches("::mod") };
            modules.insert(name.into(), Module { text: fs::read_to_string(path).unwrap(), file });
        }
    }
    modules
}

/// The sources without comments and tests; the lines keep their numbers.
fn code(text: &str) -> String {
    let (mut code, mut is_test, mut ends_with_brace) = (String::new(), false, false);
    for line in text.lines() {
        if line == "#[cfg(test)]" {
            is_test = true;
        } else if !is_test {
            code += line.split("//").next().unwrap();
        } else if !ends_with_brace && line.ends_with('{') {
            ends_with_brace = true;
        } else if line == "}" || (!ends_with_brace && line.ends_with(';')) {
            (is_test, ends_with_brace) = (false, false);
        }
        code.push('\n');
    }
    code
}

/// The paths that a `use` or an expression names, its braces resolved.
fn paths(tree: &str) -> Vec<String> {
    let Some((prefix, rest)) = tree.split_once('{') else { return vec![tree.into()] };
    let (mut depth, mut part, mut parts) = (0, String::new(), Vec::new());
    for c in rest.trim_end().trim_end_matches('}').chars() {
        depth += i32::from(c == '{') - i32::from(c == '}');
        if c == ',' && depth == 0 {
            parts.push(std::mem::take(&mut part));
        } else {
            part.push(c);
        }
    }
    parts.push(part);
    let parts = parts.iter().map(|part| part.trim()).filter(|part| !part.is_empty());
    parts.flat_map(|part| paths(&format!("{prefix}{part}"))).collect()
}

/// The module that a path leads to, as seen from another one; none outside of the crate.
fn resolved(path: &str, from: &str, modules: &BTreeMap<Name, Module>) -> Option<Name> {
    let mut place: Vec<&str> = from.split("::").filter(|part| !part.is_empty()).collect();
    let mut parts = path.split("::").map(|part| part.split_whitespace().next().unwrap_or("")).peekable();
    let first: &str = parts.peek().copied()?;
    match first {
        "crate" => {
            place.clear();
            parts.next();
        }
        "self" => _ = parts.next(),
        "super" => {
            while parts.next_if_eq(&"super").is_some() {
                place.pop();
            }
        }
        _ => _ = modules.get(&[&place[..], &[first]].concat().join("::"))?,
    }
    for part in parts {
        place.push(part);
        if !modules.contains_key(&place.join("::")) {
            place.pop();
            break;
        }
    }
    Some(place.join("::"))
}

/// What a module imports, be it by `use` or by a path in the code.
fn imports(name: &str, module: &Module, modules: &BTreeMap<Name, Module>) -> Vec<Import> {
    let mut code = code(&module.text);
    let mut found = Vec::new();
    let is_part = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    for start in ["use ", "crate::", "super::"] {
        let places: Vec<usize> = code.match_indices(start).map(|(at, _)| at).collect();
        for at in places.into_iter().filter(|&at| !code[..at].ends_with(is_part)).collect::<Vec<_>>() {
            let rest = &code[at..];
            let length = if start == "use " { rest.find(';') } else { rest.find(|c| !is_part(c)) }.unwrap();
            let tree = rest[..length].trim_start_matches("use ").split_whitespace().collect::<Vec<_>>().join(" ");
            let line = code[..at].matches('\n').count() + 1;
            for path in paths(&tree) {
                if let Some(to) = resolved(&path, name, modules).filter(|to| to != name) {
                    found.push(Import { at: format!("{}:{line}: {path}", module.file), to });
                }
            }
            let read: String = code[at..at + length].chars().map(|c| if c == '\n' { c } else { ' ' }).collect();
            code.replace_range(at..at + length, &read); // so that it is not read again
        }
    }
    found
}

/// The modules of a table in the documentation, from top to bottom: what stands between backticks in the first cells.
fn table(module: &Module) -> Vec<&str> {
    let rows = module.text.lines().filter_map(|line| line.strip_prefix("//! | ")?.split('|').next());
    rows.flat_map(|cell| cell.split('`').skip(1).step_by(2)).collect()
}

#[test]
fn tables_name_all_modules() {
    let modules = modules();
    for (name, module) in &modules {
        let prefix = if name.is_empty() { String::new() } else { format!("{name}::") };
        let children: BTreeSet<&str> =
            modules.keys().filter_map(|child| child.strip_prefix(&prefix)).filter(|c| !c.contains("::")).collect();
        let table = table(module);
        if !table.is_empty() {
            let children: BTreeSet<&str> = children.into_iter().filter(|child| !child.is_empty()).collect();
            assert_eq!(table.iter().copied().collect::<BTreeSet<_>>(), children, "the table of {}", module.file);
        }
        assert!(!name.is_empty() || !table.is_empty(), "lib.rs has a table");
    }
}

#[test]
fn modules_import_only_what_stands_above_them() {
    let modules = modules();
    let mut wrong = Vec::new();
    for (name, module) in &modules {
        for Import { at, to } in imports(name, module, &modules) {
            let (from, to): (Vec<&str>, Vec<&str>) = (name.split("::").collect(), to.split("::").collect());
            let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
            let (Some(own), Some(other)) = (from.get(common), to.get(common)) else { continue }; // one holds the other
            let order = table(&modules[&from[..common].join("::")]);
            let place = |name: &str| order.iter().position(|entry| *entry == name);
            if place(other).zip(place(own)).is_some_and(|(other, own)| other > own) {
                wrong.push(format!("{at}: {other} stands below {own}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_imports_run_in_a_circle() {
    let modules = modules();
    let mut left: BTreeMap<&str, Vec<Import>> =
        modules.iter().map(|(name, module)| (name.as_str(), imports(name, module, &modules))).collect();
    left.remove(""); // lib.rs names what is in it, and nobody imports from it but the error
    loop {
        let named: BTreeSet<&str> = left.values().flatten().map(|import| import.to.as_str()).collect();
        let is_free = |(name, of): &(&&str, &Vec<Import>)| {
            !named.contains(**name) || of.iter().all(|import| !left.contains_key(import.to.as_str()))
        };
        let Some(free) = left.iter().find(is_free).map(|(name, _)| *name) else { break };
        left.remove(free);
    }
    let lines = left.values().flatten().filter(|import| left.contains_key(&*import.to)).map(|import| &*import.at);
    assert!(left.is_empty(), "in a circle:\n{}", lines.collect::<Vec<_>>().join("\n"));
}
