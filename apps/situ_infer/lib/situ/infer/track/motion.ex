defmodule Situ.Infer.Track.Motion do
  @moduledoc false
  # Predicts the position of a box with four Kalman filters for its middle and size. Errors are relative to the box's
  # size, so that near and far objects are tracked alike.
  alias Situ.Infer.Track.Kalman
  alias Situ.Rect

  # A detector is off by this share of the box. An object may move by ten times its size in a second, and its velocity
  # may change by a few times its size.
  @error 0.05
  @speed 10.0
  @noise 3.0
  # Sizes change slowly.
  @size_speed 1.0
  @size_noise 0.2

  @type t :: {Kalman.t(), Kalman.t(), Kalman.t(), Kalman.t()}

  @spec new(Rect.t()) :: t()
  def new(rect) do
    {cx, cy, w, h} = center_and_size(rect)
    size = longer_side(rect)
    moving = &Kalman.new(&1, @error * size, &2 * size)
    {moving.(cx, @speed), moving.(cy, @speed), moving.(w, @size_speed), moving.(h, @size_speed)}
  end

  @doc "Predicts the state `seconds` later."
  @spec predict(t(), float()) :: t()
  def predict({cx, cy, w, h}, seconds) do
    size = max(w.value, h.value) |> max(1.0)

    {Kalman.predict(cx, seconds, @noise * size), Kalman.predict(cy, seconds, @noise * size),
     Kalman.predict(w, seconds, @size_noise * size),
     Kalman.predict(h, seconds, @size_noise * size)}
  end

  @spec correct(t(), Rect.t()) :: t()
  def correct({cx, cy, w, h}, rect) do
    {x, y, width, height} = center_and_size(rect)
    e = @error * longer_side(rect)

    {Kalman.correct(cx, x, e), Kalman.correct(cy, y, e), Kalman.correct(w, width, e),
     Kalman.correct(h, height, e)}
  end

  @doc "Returns `rect` with the position and size that are expected now."
  @spec expected_rect(t(), Rect.t()) :: Rect.t()
  def expected_rect({cx, cy, w, h}, rect) do
    {width, height} = {max(w.value, 0.0), max(h.value, 0.0)}
    %{rect | x: cx.value - width / 2, y: cy.value - height / 2, width: width, height: height}
  end

  defp center_and_size(r), do: {r.x + r.width / 2, r.y + r.height / 2, r.width / 1, r.height / 1}
  defp longer_side(r), do: r.width |> max(r.height) |> max(1.0)
end
