defmodule Situ.Infer.Face do
  @moduledoc """
  A face in an image, in pixels of the image.

    * `rect`: a `Situ.Rect` from brows to chin, with the detector's `score` and, once tracked, the track's `id`;
    * `eyes`: the person's right and left eye as `{x, y}` (the right one first; it is at the left of the image);
    * `nose`, `mouth`, `ears` (right, left): points in the same form.

      iex> face = %Situ.Infer.Face{rect: Situ.Rect.new!(0, 0, 10, 10), eyes: {{2.0, 3.0}, {8.0, 3.0}}}
      iex> Situ.Infer.Face.roll_angle(face)
      0.0
  """
  alias Situ.{Error, Rect}
  alias Situ.Infer.Patch

  @enforce_keys [:rect, :eyes]
  defstruct [:rect, :eyes, :nose, :mouth, :ears]

  @type t :: %__MODULE__{
          rect: Rect.t(),
          eyes: {Patch.point(), Patch.point()},
          nose: Patch.point() | nil,
          mouth: Patch.point() | nil,
          ears: {Patch.point(), Patch.point()} | nil
        }

  @most 1_000_000_000

  defguardp is_point(x, y)
            when is_number(x) and is_number(y) and abs(x) <= @most and abs(y) <= @most

  @doc """
  Returns the face if its rectangle and eyes have usable numbers. Errors: `:bad_rect`, `:bad_face`.

      iex> {:error, error} = Situ.Infer.Face.check(%Situ.Infer.Face{rect: Situ.Rect.new!(0, 0, 1, 1), eyes: nil})
      iex> error.why
      "its eyes are nil"
  """
  @spec check(term()) :: {:ok, t()} | {:error, Error.t()}
  def check(%__MODULE__{rect: rect, eyes: eyes} = face) do
    with {:ok, _} <- Rect.validate(rect) do
      case eyes do
        {{rx, ry}, {lx, ly}}
        when is_point(rx, ry) and is_point(lx, ly) ->
          {:ok, face}

        _ ->
          bad_face("its eyes are #{inspect(eyes, limit: 8, printable_limit: 80)}")
      end
    end
  end

  def check(other), do: bad_face("it is #{inspect(other, limit: 8, printable_limit: 80)}")

  defp bad_face(why) do
    {:error,
     Error.new(:bad_face, "invalid face: its coordinates cannot be used",
       why: why,
       fix: "use faces from Situ.Infer.FaceDetector; eyes are {{x, y}, {x, y}}, in pixels"
     )}
  end

  @doc "Like `check/1`, but returns the face or raises the error."
  @spec check!(term()) :: t()
  def check!(face), do: Error.unwrap!(check(face))

  @doc "Returns the roll of the head in radians; positive is clockwise on the screen."
  @spec roll_angle(t()) :: float()
  def roll_angle(%__MODULE__{eyes: {{rx, ry}, {lx, ly}}}), do: :math.atan2(ly - ry, lx - rx)

  @doc "Returns the square patch of `size` pixels around the face, `margin` times as wide as the face, with level eyes."
  @spec level_patch(t(), float(), pos_integer()) :: Patch.t()
  def level_patch(%__MODULE__{rect: rect} = face, margin, size) do
    side = max(rect.width, rect.height) * margin
    center = {rect.x + rect.width / 2, rect.y + rect.height / 2}
    Patch.centered_at(center, side, roll_angle(face), size)
  end
end
