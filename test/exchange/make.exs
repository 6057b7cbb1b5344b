# Two annotators of one session, and the schema. Times are in milliseconds.
[root] = System.argv()
alias Situ.Annotation
alias Situ.Annotation.{Layer, Recording, Schema}
schema = Schema.finite("Speech", ["speaks", "laughs"])
:ok = Schema.save(schema, Path.join(root, "schema.json"))
origin = 1_700_000_000_000_000_000
ms = 1_000_000

make = fn spans ->
  {:ok, layer} =
    Layer.new(
      schema,
      for {track, from, to, value} <- spans do
        Annotation.new(origin + from * ms, origin + to * ms, track, %{"Speech" => value})
      end
    )

  layer
end

anna = [
  {"P1", 500, 1_500, "speaks"},
  {"P1", 1_500, 2_250, "laughs"},
  {"Zoë & co", 700, 3_001, "speaks"}
]

ben = [
  {"P1", 610, 1_480, "speaks"},
  {"P1", 1_500, 2_500, "speaks"},
  {"Zoë & co", 700, 2_800, "speaks"}
]

{:ok, _} = Recording.write(make.(anna), Path.join(root, "anna"), "Speech")
{:ok, _} = Recording.write(make.(ben), Path.join(root, "ben"), "Speech")

# Boxes with two key frames, and the images between them.
numbers = for name <- ~w(x y width height), do: %{"name" => name, "kind" => "number"}
kinds = for value <- ~w(face hand), do: %{"value" => value}
kind = %{"name" => "Kind", "kind" => "finite", "values" => kinds}
{:ok, boxes} = Schema.parse(%{"name" => "Boxes", "attributes" => [kind | numbers]})

box = fn ms_at, track, kind, [x, y, w, h] ->
  values = %{"Kind" => kind, "x" => x, "y" => y, "width" => w, "height" => h}
  Annotation.new(origin + ms_at * ms, origin + ms_at * ms, track, values)
end

{:ok, layer} =
  Layer.new(boxes, [
    box.(0, "Anna", "face", [10, 20, 30.5, 40]),
    box.(100, "Anna", "face", [20, 40, 30.5, 60]),
    box.(50, "Ben", "hand", [1, 2, 3, 4])
  ])

{:ok, _} = Recording.write(layer, Path.join(root, "boxes"), "Boxes")
{:ok, writer} = Situ.Store.Writer.create("film", root)
{:ok, video} = Situ.Store.Writer.stream(writer, "Video", type: :integer)

pictures =
  for n <- 0..4 do
    time = origin + n * 25 * ms
    %Situ.Message{data: n, originating_time: time, creation_time: time, sequence_id: n + 1}
  end

{:ok, _} = Situ.Store.Writer.append(video, pictures)
:ok = Situ.Store.Writer.close(writer)

# Tiers with all relations of ELAN.
tier = fn name, parent, relation ->
  attribute = if name == "Kind", do: "Kind", else: "Text"
  %{"name" => name, "attribute" => attribute, "parent" => parent, "relation" => relation}
end

{:ok, speech} =
  Schema.parse(%{
    "name" => "Tiers",
    "attributes" => [%{"name" => "Text", "kind" => "text"}, Map.put(kind, "values", kinds)],
    "tiers" => [
      tier.("Utterance", nil, nil),
      tier.("Words", "Utterance", "included_in"),
      tier.("Turns", "Utterance", "time_subdivision"),
      tier.("Parts", "Words", "symbolic_subdivision"),
      tier.("Kind", "Parts", "symbolic_association")
    ]
  })

text = fn track, from, to, text ->
  attribute = if track =~ "Kind", do: "Kind", else: "Text"
  Annotation.new(origin + from * ms, origin + to * ms, track, %{attribute => text})
end

{:ok, layer} =
  Layer.new(speech, [
    text.("Utterance@Ada", 1_000, 3_000, "come here & see"),
    text.("Turns@Ada", 1_000, 2_000, "first"),
    text.("Turns@Ada", 2_000, 3_000, "second"),
    text.("Words@Ada", 1_100, 1_500, "come"),
    text.("Words@Ada", 1_600, 2_200, "here"),
    text.("Parts@Ada", 1_100, 1_300, "co"),
    text.("Parts@Ada", 1_300, 1_500, "me"),
    text.("Kind@Ada", 1_300, 1_500, "hand"),
    text.("Utterance@Ben", 1_000, 1_400, "yes")
  ])

{:ok, _} = Recording.write(layer, Path.join(root, "tiers"), "Tiers")
