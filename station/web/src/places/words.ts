// Where the robot is, in words: the place beside the room that it is in.
import type { CurrentPlace, PlaceInRoom, RoomName } from "../link/messages";

/**
 * What is said of the place below these rooms, of which the robot is in one. The nearest place may be another room's: then
 * the door between both is told, or nothing (null).
 */
export function placeInWords(place: PlaceInRoom, rooms: RoomName[]): string | null {
  if (place.room === null || rooms.length === 0 || rooms.some(({ id }) => id === place.room)) return place.name;
  for (const { name } of rooms) {
    const end = ` · door to ${name}`;
    if (place.name.endsWith(end)) return `near the door to ${place.name.slice(0, -end.length)}`;
  }
  return null;
}

/** The room that the robot is in; both of a doorway. */
export function roomsOf({ room, room_alternatives: [other], doorway }: CurrentPlace): RoomName[] {
  if (!room) return [];
  return doorway !== null && other ? [room, other] : [room];
}
