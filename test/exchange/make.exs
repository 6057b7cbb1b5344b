# Two annotators of one session, and the schema; times to the millisecond.
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
