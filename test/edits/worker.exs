# One program that edits a dataset and a layer of annotations, and writes a line for each acknowledged edit. It
# continues after its last acknowledged edit. Usage: worker.exs STUDY.json STORE NAME EDITS ACKNOWLEDGED
alias Situ.{Annotation, Dataset}
alias Situ.Annotation.{Editor, Layer, Schema}

defmodule Worker do
  # An edit that was in progress when the program was killed may have been applied, so it is checked first.
  def edit(%{dataset: dataset, name: name} = state, n) when rem(n, 5) == 0 do
    session = "#{name}-#{n}"

    {:ok, dataset} =
      Dataset.update(dataset, fn now ->
        if match?({:ok, _}, Dataset.session(now, session)),
          do: {:ok, now},
          else: Dataset.add_session(now, session)
      end)

    {"session #{session}", %{state | dataset: dataset}}
  end

  def edit(%{dataset: dataset, name: name} = state, n) when rem(n, 5) == 1 do
    tag = "#{name}-#{n}"
    add = &Dataset.put_fields(&1, tags: Enum.uniq(&1.tags ++ [tag]))
    {:ok, dataset} = Dataset.update(dataset, add)
    {"tag #{tag}", %{state | dataset: dataset}}
  end

  # A counter shows whether an edit was applied twice.
  def edit(%{dataset: dataset, name: name} = state, n) when rem(n, 5) == 2 do
    count = fn session ->
      {:ok, update_in(session.metadata[name], &((&1 || 0) + 1))}
    end

    {:ok, dataset} = Dataset.update(dataset, &Dataset.update_session(&1, "shared", count))
    {"count #{name}", %{state | dataset: dataset}}
  end

  def edit(%{editor: editor, name: name} = state, n) when rem(n, 5) == 3 do
    one = Annotation.new(n * 10, n * 10 + 5, name, %{}, note: "#{n}")

    case Editor.edit(editor, &Layer.add(&1, one)) do
      {:ok, _} -> :ok
      {:error, %{code: :overlap}} -> :ok
    end

    {"annotation #{name} #{n}", state}
  end

  def edit(%{editor: editor, name: name} = state, n) do
    change = fn layer ->
      own = Layer.on_track(layer, name)
      Layer.change(layer, List.last(own).id, values: %{"Text" => "#{n}"})
    end

    {:ok, _} = Editor.edit(editor, change)
    if rem(n, 40) == 4, do: {:ok, _} = Editor.save(editor)
    {"value #{name} #{n - 1} #{n}", state}
  end
end

[file, store, name, edits, acknowledged] = System.argv()
{:ok, _} = Application.ensure_all_started(:situ_dataset)
{:ok, dataset} = Dataset.load(file)
schema = Schema.text("Text")
{:ok, editor} = Editor.start_link(path: store, stream: "Speech", schema: schema)
first = acknowledged |> File.read!() |> String.split("\n", trim: true) |> length()
{:ok, log} = :file.open(acknowledged, [:append, :raw])

Enum.reduce(
  first..(String.to_integer(edits) - 1)//1,
  %{dataset: dataset, editor: editor, name: name},
  fn n, state ->
    {line, state} = Worker.edit(state, n)
    :ok = :file.write(log, line <> "\n")
    state
  end
)
