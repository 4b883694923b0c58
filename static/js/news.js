/**
 * News of one kind, for all who asked for them.
 *
 * @template {any[]} T What they say.
 * @returns {{hear: (call: (...said: T) => void) => () => void, tell: (...said: T) => void}} `hear` returns what stops it.
 */
export function news() {
  /** @type {Set<(...said: T) => void>} */
  const calls = new Set();
  return {
    hear(call) {
      calls.add(call);
      return () => calls.delete(call);
    },
    tell(...said) {
      for (const call of [...calls]) call(...said);
    },
  };
}
