// For `tsc --checkJs`: the one object our scripts share, and viser's window into itself.
interface Window {
  desirePath: any;
  desirePathConfig: { pageOrigin: string };
  __viserMutable: any;
}
