import { defineConfig } from "vite";

// One script and one style sheet; everything the page needs comes from the station itself.
export default defineConfig({
  base: "/",
  build: { target: "es2022", modulePreload: { polyfill: false }, chunkSizeWarningLimit: 1500 },
});
