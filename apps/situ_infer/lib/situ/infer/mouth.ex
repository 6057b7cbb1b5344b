defmodule Situ.Infer.Mouth do
  @moduledoc """
  How far a mouth is open.

    * `opening`: distance of the inner lips over the distance of the outer eye corners: about 0.0 to 0.2 closed,
      depending on the face, up to 0.4 wide open
    * `baseline`: the opening of **this** mouth when it is closed, learnt while watching
    * `open?`: clearly more open than that

  Only the change within one face means anything: a smile with teeth measures as open as another face speaking. So a
  fixed threshold fails, and each face gets a baseline that falls at once and rises slowly.

      iex> mouth = Situ.Infer.Mouth.watch(nil, 0, 0.12)
      iex> mouth = Situ.Infer.Mouth.watch(mouth, 40_000_000, 0.2)
      iex> {mouth.open?, Float.round(mouth.baseline, 3)}
      {true, 0.12}
  """
  alias Situ.Infer.FaceMesh

  # The baseline goes half way down in 80 ms (two pictures, so that one bad one does not set it), and up by a third in
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

  @doc "The opening seen on a mesh; 0.0 when its eyes coincide."
  @spec opening(FaceMesh.t()) :: float()
  def opening(%FaceMesh{} = mesh) do
    eyes = FaceMesh.distance(mesh, 33, 263)
    if eyes > 1.0e-6, do: FaceMesh.distance(mesh, 13, 14) / eyes, else: 0.0
  end

  @doc "The next opening of the same mouth; `nil` for the first."
  @spec watch(t() | nil, Situ.Time.t(), float(), Situ.Rect.t() | nil) :: t()
  def watch(before, time, opening, rect \\ nil)

  def watch(nil, time, opening, rect),
    do: %__MODULE__{opening: opening, baseline: opening, open?: false, time: time, rect: rect}

  def watch(%__MODULE__{} = before, time, opening, rect) do
    baseline = before.baseline + (opening - before.baseline) * share(before, time, opening)
    open? = opening - baseline > @open
    %__MODULE__{opening: opening, baseline: baseline, open?: open?, time: time, rect: rect}
  end

  defp share(before, time, opening) do
    passed = max(time - before.time, 0)

    if opening < before.baseline,
      do: 1.0 - :math.pow(0.5, passed / @fall_ns),
      else: 1.0 - :math.exp(-passed / @rise_ns)
  end
end
