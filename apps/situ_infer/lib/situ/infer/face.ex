defmodule Situ.Infer.Face do
  @moduledoc """
  A face in a picture, in picture pixels.

    * `rect`: a `Situ.Rect` around brows to chin, with the detector's `score` and, once tracked, the track's `id`;
    * `eyes`: the person's right and left eye as `{x, y}` (right first, so it is at the left of the picture);
    * `nose`, `mouth`, `ears` (right, left): likewise.

      iex> face = %Situ.Infer.Face{rect: Situ.Rect.new!(0, 0, 10, 10), eyes: {{2.0, 3.0}, {8.0, 3.0}}}
      iex> Situ.Infer.Face.roll(face)
      0.0
  """
  alias Situ.Infer.Patch
  alias Situ.Rect

  @enforce_keys [:rect, :eyes]
  defstruct [:rect, :eyes, :nose, :mouth, :ears]

  @type t :: %__MODULE__{
          rect: Rect.t(),
          eyes: {Patch.point(), Patch.point()},
          nose: Patch.point() | nil,
          mouth: Patch.point() | nil,
          ears: {Patch.point(), Patch.point()} | nil
        }

  @doc "The track's id, `nil` before tracking."
  @spec id(t()) :: term()
  def id(%__MODULE__{rect: rect}), do: rect.id

  @doc "How far the head leans, radians; positive is clockwise on the screen."
  @spec roll(t()) :: float()
  def roll(%__MODULE__{eyes: {{rx, ry}, {lx, ly}}}), do: :math.atan2(ly - ry, lx - rx)

  @doc "The square patch of `size` pixels around the face, `margin` times as wide as it, with the eyes level."
  @spec patch(t(), float(), pos_integer()) :: Patch.t()
  def patch(%__MODULE__{rect: rect} = face, margin, size) do
    side = max(rect.width, rect.height) * margin
    center = {rect.x + rect.width / 2, rect.y + rect.height / 2}
    Patch.around(center, side, roll(face), size)
  end
end
