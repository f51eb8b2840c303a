// Rules for the page's TypeScript: the strict ones that know its types, and which folder may import which.
import js from "@eslint/js";
import { defineConfig, globalIgnores } from "eslint/config";
import tseslint from "typescript-eslint";

/** A folder of src/ imports its own files and those of these folders; the files beside the folders put everything together. */
const MAY_IMPORT = {
  link: [],
  ui: [],
  drive: ["link", "ui"],
  places: ["link", "ui"],
  plan: ["link", "ui", "places"],
  map: ["link", "ui", "places", "plan"],
  review: ["link", "ui", "map"],
  library: ["link", "ui"],
  robots: ["link", "ui"],
  status: ["link", "ui", "library"],
};

const FOLDERS = Object.entries(MAY_IMPORT).map(([folder, others]) => ({
  files: [`src/${folder}/**`],
  rules: {
    "no-restricted-imports": [
      "error",
      {
        patterns: [
          {
            regex: `^\\.\\./(?!(${others.join("|")})/)`,
            message: `${folder}/ may import from ${others.join(", ") || "no other folder"}`,
          },
        ],
      },
    ],
  },
}));

// What the strict rules do not take for text in a template either.
const NO_TEXT = { allowAny: false, allowBoolean: false, allowNever: false, allowNullish: false, allowRegExp: false };

export default defineConfig(
  globalIgnores(["dist"]),
  { linterOptions: { reportUnusedDisableDirectives: "error" } },
  js.configs.recommended,
  tseslint.configs.strictTypeChecked,
  tseslint.configs.stylisticTypeChecked,
  {
    languageOptions: { parserOptions: { projectService: { allowDefaultProject: ["*.js", "*.ts"] } } },
    rules: {
      "@typescript-eslint/no-confusing-void-expression": ["error", { ignoreArrowShorthand: true }],
      "@typescript-eslint/restrict-template-expressions": ["error", { ...NO_TEXT, allowNumber: true }],
    },
  },
  FOLDERS,
);
