// The first thing that runs: find out who looks at the page, then load the rest of it.
import "./style.css";
import { enter } from "./access";
import { dress } from "./ui/theme";

dress();
const session = await enter();
document.body.dataset.role = session.role;
document.body.dataset.controlled = String(session.controlled);
await import("./main");
