# Compares a dataset and its annotations with the lists of acknowledged edits. Usage: check.exs STUDY.json STORE LIST...
# A list NAME.KILLS belongs to a worker that was killed KILLS times, and each kill may have left one more edit.
alias Situ.Annotation.{Editor, Layer}
alias Situ.Dataset

[file, store | lists] = System.argv()
{:ok, _} = Application.ensure_all_started(:situ_dataset)
{:ok, dataset} = Dataset.load(file)

{:ok, editor} =
  Editor.start_link(path: store, stream: "Speech", schema: Situ.Annotation.Schema.text("Text"))

layer = Editor.current_layer(editor)
sessions = for s <- dataset.sessions, do: s.name
{:ok, %{metadata: counts}} = Dataset.session(dataset, "shared")

results =
  for list <- lists do
    [_, kills] = list |> Path.basename() |> String.split(".")
    name = list |> Path.basename() |> Path.rootname()

    acknowledged =
      list |> File.read!() |> String.split("\n", trim: true) |> Enum.map(&String.split/1)

    annotations = Layer.on_track(layer, name)
    values = for ["value", _, at, value] <- acknowledged, into: %{}, do: {at, value}

    lost =
      for(["session", s] <- acknowledged, s not in sessions, do: s) ++
        for(["tag", t] <- acknowledged, t not in dataset.tags, do: t) ++
        for(
          ["annotation", _, n] <- acknowledged,
          Enum.count(annotations, &(&1.note == n)) != 1,
          do: n
        ) ++
        for {at, value} <- values,
            a = Enum.find(annotations, &(&1.note == at)),
            a.values["Text"] != value,
            do: {at, value, a.values}

    counted = Enum.count(acknowledged, &match?(["count", _], &1))
    extra = Map.get(counts, name, 0) - counted
    own = Enum.filter(sessions ++ dataset.tags, &String.starts_with?(&1, name <> "-"))
    listed = for [kind, x] when kind in ["session", "tag"] <- acknowledged, do: x
    strange = length(own -- listed) + length(own) - length(Enum.uniq(own))
    kills = String.to_integer(kills)

    if lost == [] and extra in 0..kills and strange <= kills do
      :ok
    else
      IO.puts(
        "FAILED #{name}: lost #{inspect(lost)}, counted #{extra} too often, #{strange} not acknowledged"
      )

      :failed
    end
  end

acknowledged =
  lists
  |> Enum.map(&(&1 |> File.read!() |> String.split("\n", trim: true) |> length()))
  |> Enum.sum()

IO.puts(
  "  #{acknowledged} acknowledged edits, #{length(sessions)} sessions, #{length(Layer.annotations(layer))} annotations"
)

IO.puts(
  "#{Enum.count(results, &(&1 == :ok))} passed, #{Enum.count(results, &(&1 == :failed))} failed"
)

if :failed in results, do: System.halt(1)
