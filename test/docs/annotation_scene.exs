defmodule AnnotationScene do
  @moduledoc false
  # The session of "From recordings to labels": tiers, and the layers of two annotators.
  alias Situ.Annotation
  alias Situ.Annotation.{Edit, Layer, Schema}
  alias Situ.{Dataset, Time}
  alias Situ.Dataset.SessionLayers

  def create(folder) do
    study = Path.join(folder, "study.json")
    {:ok, dataset} = Dataset.new("Interviews", file: study, autosave: true)
    {:ok, dataset} = Dataset.add_session(dataset, "p01")
    {:ok, dataset} = Dataset.add_partition(dataset, "p01", "Talk", Path.join(folder, "talk1.mp4"))
    tier = &%{"name" => &1, "attribute" => &1, "parent" => &2, "relation" => &3}
    text = &%{"name" => &1, "kind" => "text"}

    {:ok, tiers} =
      Schema.parse(%{
        "name" => "Talk",
        "attributes" => Enum.map(~w(Utterance Words English), text),
        "tiers" => [
          tier.("Utterance", nil, nil),
          tier.("Words", "Utterance", "included_in"),
          tier.("English", "Utterance", "symbolic_association")
        ]
      })

    at = fn track, from, to, value ->
      Annotation.new(Time.ms(from), Time.ms(to), track, %{track => value})
    end

    {:ok, talk} =
      Layer.new(tiers, [
        at.("Utterance", 400, 2_100, "so what do you think"),
        at.("Utterance", 2_100, 3_900, "I think it works"),
        at.("Utterance", 4_300, 6_000, ""),
        at.("Words", 500, 800, "so"),
        at.("Words", 850, 1_300, "what"),
        at.("English", 400, 2_100, "so what do you think"),
        at.("English", 2_100, 3_900, "")
      ])

    turns = fn spans ->
      {:ok, empty} = Layer.new(Schema.finite("Turn", ["speaks", "laughs"]))

      Enum.reduce(spans, empty, fn {track, from, to, value}, layer ->
        annotation = Annotation.new(Time.ms(from), Time.ms(to), track, %{"Turn" => value})
        {:ok, layer, _} = Edit.annotate(layer, annotation)
        layer
      end)
    end

    ada = [
      {"A", 400, 2_100, "speaks"},
      {"A", 4_300, 6_000, "speaks"},
      {"B", 2_100, 3_900, "laughs"}
    ]

    ben = [
      {"A", 500, 2_100, "speaks"},
      {"A", 4_300, 5_600, "speaks"},
      {"B", 2_100, 3_900, "speaks"}
    ]

    _ =
      for {name, layer} <- [{"Talk", talk}, {"Turn.Ada", turns.(ada)}, {"Turn.Ben", turns.(ben)}],
          reduce: dataset do
        dataset ->
          {:ok, dataset} = SessionLayers.create_layer(dataset, "p01", name, layer)
          dataset
      end

    :ok
  end
end
