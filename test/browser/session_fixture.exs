defmodule SessionFixture do
  @moduledoc false
  # A study of three sessions with several partitions each, for annotation. The first one has a
  # partition with forty proposals, as a batch task writes it.
  alias Situ.Annotation
  alias Situ.Annotation.{Edit, Layer, Recording, Schema}
  alias Situ.Dataset

  @second 1_000_000_000

  def create(folder, recordings) do
    room = Path.join(recordings, "minute.0000")
    wearable = Path.join(recordings, "uneven.0000")
    file = Path.join(folder, "study.json")
    {:ok, dataset} = Dataset.new("Annotated study", file: file, autosave: true)

    detected = [{"Detected", write_proposals(folder)}]

    for {name, more} <- [{"s1", detected}, {"s2", []}, {"s3", []}], reduce: dataset do
      dataset ->
        {:ok, dataset} = Dataset.add_session(dataset, name)

        for {part, path} <- [{"Room", room}, {"Wearable", wearable} | more], reduce: dataset do
          dataset ->
            {:ok, dataset} = Dataset.add_partition(dataset, name, part, path)
            dataset
        end
    end
  end

  defp write_proposals(folder) do
    values = [%{"value" => "speaks", "key" => "1"}, %{"value" => "laughs", "key" => "2"}]
    attribute = %{"name" => "Speech", "kind" => "finite", "values" => values}
    {:ok, schema} = Schema.parse(%{"name" => "Speech", "attributes" => [attribute]})
    {:ok, empty} = Layer.new(schema)

    found =
      for n <- 0..39 do
        from = Fixture.t0() + n * @second
        values = %{"Speech" => "speaks"}
        Annotation.new(from, from + div(@second, 2), "A", values, confidence: 0.5, by: "detector")
      end

    {:ok, layer, _} = Edit.add_proposals(empty, found)
    {:ok, path} = Recording.write(layer, Path.join(folder, "s1/Detected"), "Speech")
    path
  end
end
