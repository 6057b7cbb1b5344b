defmodule Situ.Infer.Mouth do
  @moduledoc false
  # The opening of a mouth (`Situ.Infer.MouthShape` lists the fields), and its baseline. One
  # person's smile with teeth can have the same opening as another person's mouth while speaking.
  # A fixed threshold therefore fails, and each face gets a baseline that falls quickly and rises
  # slowly.
  alias Situ.Infer.FaceMesh

  # The baseline falls by half in 80 ms (two images, so that a single bad one does not set it), and rises by a third in
  # 8 s.
  @fall_ns 80_000_000
  @rise_ns 20_000_000_000
  @open 0.03

  @enforce_keys [:opening, :baseline, :open?, :time]
  defstruct [:opening, :baseline, :open?, :time, :rect]

  @type t :: %__MODULE__{
          opening: float(),
          baseline: float(),
          open?: boolean(),
          time: Situ.Time.t(),
          rect: Situ.Rect.t() | nil
        }

  @doc "Returns the opening of the mouth in a mesh, or 0.0 if the corners of its eyes coincide."
  @spec measure_opening(FaceMesh.t()) :: float()
  def measure_opening(%FaceMesh{} = mesh) do
    eyes = FaceMesh.point_distance(mesh, 33, 263)
    if eyes > 1.0e-6, do: FaceMesh.point_distance(mesh, 13, 14) / eyes, else: 0.0
  end

  @doc """
  Updates the mouth with its next opening; `before` is `nil` for the first.

      iex> mouth = Situ.Infer.Mouth.track_opening(nil, 0, 0.12)
      iex> mouth = Situ.Infer.Mouth.track_opening(mouth, 40_000_000, 0.2)
      iex> {mouth.open?, Float.round(mouth.baseline, 3)}
      {true, 0.12}
  """
  @spec track_opening(t() | nil, Situ.Time.t(), float(), Situ.Rect.t() | nil) :: t()
  def track_opening(before, time, opening, rect \\ nil)

  def track_opening(nil, time, opening, rect),
    do: %__MODULE__{opening: opening, baseline: opening, open?: false, time: time, rect: rect}

  def track_opening(%__MODULE__{} = before, time, opening, rect) do
    baseline =
      before.baseline + (opening - before.baseline) * baseline_weight(before, time, opening)

    open? = opening - baseline > @open
    %__MODULE__{opening: opening, baseline: baseline, open?: open?, time: time, rect: rect}
  end

  defp baseline_weight(before, time, opening) do
    passed = max(time - before.time, 0)

    if opening < before.baseline,
      do: 1.0 - :math.pow(0.5, passed / @fall_ns),
      else: 1.0 - :math.exp(-passed / @rise_ns)
  end
end
