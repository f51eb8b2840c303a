// Where the robot is, in words: the place beside the room that it is in.
import type { CurrentPlace, PlaceName, RoomName } from "../link/messages";

interface Placed {
  place: PlaceName | null;
  place_room: string | null; // that the place is in
  place_elsewhere: boolean; // that is another room than the one that is named
}

/**
 * What is said of the place below the rooms that the robot is in: one, or both of a doorway. The nearest place may be
 * another room's: then the door between both is told, or nothing (null).
 */
export function placeInWords(placed: Placed, rooms: RoomName[]): string | null {
  const { place, place_room, place_elsewhere } = placed;
  if (!place || !place_elsewhere || rooms[1]?.id === place_room) return place?.name ?? null;
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
