// Copies the packages under "dependencies" of package.json to frontend/static/npm, as they are published, one module each
// (ES modules); only the names by which they import each other become files there, as browsers find them by no other means
// without an inline script. Not kept in the repository: where they are missing, pages do with a plain text field.
import { mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const root = join(dirname(fileURLToPath(import.meta.url)), "..");
const packages = Object.keys(JSON.parse(readFileSync(join(root, "package.json"), "utf8")).dependencies);
const out = join(root, "frontend", "static", "npm");
const fileOf = (name) => name.replace("@", "").replace("/", "-");

rmSync(out, { recursive: true, force: true });
mkdirSync(out, { recursive: true });
for (const name of packages) {
  const folder = join(root, "node_modules", name);
  const { exports, module, version } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  const entry = exports?.import ?? exports?.["."]?.import ?? module ?? exports;
  const path = typeof entry === "string" ? entry : entry.default;
  const text = readFileSync(join(folder, path), "utf8").replace(/^((?:import|export)\s+(?:[\w*{][^;'"=()]*from\s*)?)(['"])([@\w][^'"]*)\2/gm, (whole, before, quote, used) => {
    if (!packages.includes(used)) throw new Error(`${name} imports ${used}, which package.json does not name`);
    return `${before}${quote}./${fileOf(used)}.js${quote}`;
  });
  writeFileSync(join(out, `${fileOf(name)}.js`), `// ${name} ${version}, its licence: ${fileOf(name)}.LICENSE\n${text}`);
  writeFileSync(join(out, `${fileOf(name)}.LICENSE`), readFileSync(join(folder, "LICENSE"), "utf8"));
}
console.log(`${packages.length} modules in frontend/static/npm`);
