defmodule Situ.Infer.MouthTracker do
  @moduledoc false
  # Measures the mouth of every face.
  #
  # Input `:in` is a list of `Situ.Infer.FaceMesh` with ids. Output `:out` is a map from id to
  # `Situ.Infer.Mouth`, at the same time. The baseline of a face that has not been found for ten
  # seconds is dropped.
  use Situ.Component,
    inputs: [in: {:list, Situ.Infer.FaceMesh}],
    outputs: [out: {:map, :any, Situ.Infer.Mouth}]

  alias Situ.Infer.Mouth

  @forget_ns 10_000_000_000

  @impl true
  def init(_opts), do: {:ok, %{}}

  @impl true
  def handle_message(:in, message, _context, latest) do
    time = message.originating_time

    mouths =
      Map.new(message.data, fn mesh ->
        {mesh.id,
         Mouth.track_opening(latest[mesh.id], time, Mouth.measure_opening(mesh), mesh.rect)}
      end)

    latest =
      latest |> Map.merge(mouths) |> Map.filter(fn {_, m} -> time - m.time < @forget_ns end)

    {[{:out, time, mouths}], latest}
  end

  @impl true
  def describe(latest), do: "#{map_size(latest)} mouths known"
end
