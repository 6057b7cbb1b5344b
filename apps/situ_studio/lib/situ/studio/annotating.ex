defmodule Situ.Studio.Annotating do
  @moduledoc """
  Annotations of one recording while people edit them in the page: where they are kept, what the page is told, and what
  each of its requests does to them.

  Each stream lies in a store of its own beside the recording (`Situ.Studio.Annotating.Shelf`), which is never
  changed in place. Every edit is on the disk before it is answered (`Situ.Annotation.Editor`): a page or a server that
  dies loses none.

      iex> {:ok, schema} = Situ.Studio.Annotating.schema("Speech", "speaks 1 #1f77b4\\nlaughs 2")
      iex> for v <- hd(schema.attributes).values, do: {v.value, v.key, v.fill}
      [{"speaks", "1", "#1f77b4"}, {"laughs", "2", nil}]
      iex> {:error, error} = Situ.Studio.Annotating.schema("Speech", "a 1\\nb 1")
      iex> error.code
      :bad_schema
  """
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.{Edit, Editor, Layer, Schema}
  alias Situ.Studio.Annotating.{SchemaForm, Shelf}
  alias Situ.Studio.{Catalog, WholeNumber}

  @most 20_000

  @doc "The schema of one attribute from what a person writes: a value a line, with its key and its colour behind it."
  @spec schema(String.t(), String.t()) :: {:ok, Schema.t()} | {:error, Error.t()}
  def schema(name, text) do
    values =
      for line <- String.split(text, ~r/[\n,;]/, trim: true),
          String.trim(line) != "",
          do: value(line)

    attribute =
      if values == [],
        do: %{"name" => name, "kind" => "text"},
        else: %{"name" => name, "kind" => "finite", "values" => values}

    Schema.parse(%{"name" => name, "attributes" => [attribute]})
  end

  defp value(line) do
    {marks, words} =
      line |> String.split() |> Enum.reverse() |> Enum.split_while(&(mark(&1) != nil))

    # a value that looks like a key is a value all the same
    {marks, words} =
      if words == [], do: {Enum.drop(marks, -1), [List.last(marks)]}, else: {marks, words}

    for mark <- marks,
        into: %{"value" => words |> Enum.reverse() |> Enum.join(" ")},
        do: mark(mark)
  end

  defp mark("#" <> _ = fill), do: {"fill", fill}
  defp mark(<<_::utf8>> = key), do: {"key", key}
  defp mark(_), do: nil

  @doc """
  The schema of boxes or points on pictures: their places are numbers, in pixels, and each annotation is a key frame.
  """
  @spec spatial(String.t(), :box | :point) :: Schema.t()
  def spatial(name, kind) do
    names = if kind == :box, do: ~w(x y width height), else: ~w(x y)
    numbers = for n <- names, do: %{"name" => n, "kind" => "number"}
    {:ok, schema} = Schema.parse(%{"name" => name, "attributes" => numbers})
    schema
  end

  @doc """
  The editor of a stream of annotations, started for the first page that asks; `schema` makes one that is not there yet.
  """
  @spec open(Catalog.id(), Path.t(), String.t(), Schema.t() | nil) ::
          {:ok, pid()} | {:error, Error.t()}
  def open(studio, path, stream, schema) do
    name = {:via, Registry, {Situ.Studio.Registry, {studio, :annotation, path, stream}}}
    opts = [path: Shelf.store(path, stream), stream: stream, schema: schema, name: name]
    child = %{id: Editor, start: {Editor, :start_link, [opts]}, restart: :temporary}

    case DynamicSupervisor.start_child(Catalog.watches(studio), child) do
      {:ok, pid} ->
        kept(pid, schema)

      {:error, {:already_started, pid}} ->
        {:ok, pid}

      {:error, %Error{} = error} ->
        {:error, error}

      {:error, reason} ->
        {:error, Error.new(:not_opened, "the annotations cannot be opened: #{inspect(reason)}")}
    end
  end

  # The journal does not hold the schema: of a stream just made it is written at once.
  defp kept(pid, nil), do: {:ok, pid}

  defp kept(pid, _schema) do
    with {:ok, _} <- Editor.save(pid), do: {:ok, pid}
  end

  @doc "Everything the page draws of them."
  @spec told(pid(), String.t()) :: map()
  def told(editor, stream) do
    layer = Editor.layer(editor)
    status = Editor.status(editor)

    %{
      stream: stream,
      attributes: Enum.map(layer.schema.attributes, &attribute/1),
      tracks: Layer.tracks(layer),
      items: layer |> Layer.annotations() |> Enum.take(@most) |> Enum.map(&item/1),
      undo: status.undo,
      redo: status.redo,
      unsaved: status.unsaved?,
      recovered: status.recovered
    }
  end

  defp attribute(a) do
    values = for v <- a.values, do: Map.take(v, [:value, :fill, :key])
    %{name: a.name, kind: a.kind, default: a.default, fill: a.fill, values: values}
  end

  # Times as text: the page's numbers are not exact that far from 1970.
  defp item(a) do
    %{
      id: a.id,
      from: Integer.to_string(a.from),
      to: Integer.to_string(a.to),
      track: a.track,
      values: a.values,
      proposed: a.proposed?,
      confidence: a.confidence,
      note: a.note,
      by: a.by
    }
  end

  @doc "Carries out an edit of the page; an error names the rule that it would break."
  @spec edit(pid(), map()) :: :ok | {:error, Error.t()}
  def edit(editor, %{"do" => "undo"}), do: done(Editor.undo(editor))
  def edit(editor, %{"do" => "redo"}), do: done(Editor.redo(editor))
  def edit(editor, %{"do" => "save"}), do: done(Editor.save(editor))

  def edit(editor, %{"do" => name} = params),
    do: done(Editor.edit(editor, &change(name, &1, params)))

  def edit(_, _), do: bad()

  defp done({:ok, _}), do: :ok
  defp done(error), do: error

  defp change("add", layer, %{"from" => from, "to" => to, "track" => track} = params) do
    with {:ok, from} <- time(from),
         {:ok, to} <- time(to),
         {:ok, track} <- name(track) do
      values = values(params["values"])
      by = by(params["by"])
      Layer.add(layer, Annotation.new(min(from, to), max(from, to), track, values, by: by))
    end
  end

  # A key frame: the place of a box or a point at one moment; it replaces an earlier one there.
  defp change("key_frame", layer, %{"at" => at, "track" => track} = params) do
    with {:ok, at} <- time(at), {:ok, track} <- name(track) do
      values = values(params["values"])

      case Enum.find(Layer.on_track(layer, track), &(&1.from == at and &1.to == at)) do
        nil -> Layer.add(layer, Annotation.new(at, at, track, values, by: by(params["by"])))
        old -> Layer.change(layer, old.id, values: Map.merge(old.values, values))
      end
    end
  end

  defp change("interval", layer, %{"id" => id, "from" => from, "to" => to}) do
    with {:ok, id} <- id(id),
         {:ok, from} <- time(from),
         {:ok, to} <- time(to),
         do: Edit.set_interval(layer, id, {min(from, to), max(from, to)})
  end

  defp change("confidence", layer, %{"id" => id, "confidence" => confidence})
       when confidence == nil or (is_number(confidence) and confidence >= 0 and confidence <= 1),
       do:
         with(
           {:ok, id} <- id(id),
           do: Layer.change(layer, id, confidence: confidence && confidence / 1)
         )

  defp change("delete_track", layer, %{"track" => track}),
    do: Edit.delete_track(layer, to_string(track))

  defp change("edge", layer, %{"id" => id, "edge" => edge, "to" => to} = params)
       when edge in ["from", "to"] do
    edge = if edge == "from", do: :from, else: :to

    with {:ok, id} <- id(id),
         {:ok, to} <- time(to),
         do: Edit.move_edge(layer, id, edge, to, alone: params["alone"] == true)
  end

  defp change("remove", layer, %{"id" => id}),
    do: with({:ok, id} <- id(id), do: Layer.remove(layer, id))

  defp change("value", layer, %{"id" => id, "attribute" => attribute, "value" => value}),
    do: with({:ok, id} <- id(id), do: Layer.set_value(layer, id, to_string(attribute), value))

  defp change("split", layer, %{"id" => id, "at" => at}),
    do: with({:ok, id} <- id(id), {:ok, at} <- time(at), do: Edit.split(layer, id, at))

  defp change("merge", layer, %{"id" => id, "with" => other}),
    do: with({:ok, id} <- id(id), {:ok, other} <- id(other), do: Edit.merge(layer, id, other))

  defp change("note", layer, %{"id" => id, "note" => note}) when is_binary(note),
    do: with({:ok, id} <- id(id), do: Layer.change(layer, id, note: String.slice(note, 0, 2_000)))

  defp change("accept", layer, %{"id" => id}),
    do: with({:ok, id} <- id(id), do: Layer.accept(layer, id))

  defp change("accept_all", layer, params), do: Edit.accept_all(layer, least(params["least"]))
  defp change("reject_all", layer, params), do: Edit.reject_all(layer, least(params["least"]))

  defp change("rename_track", layer, %{"track" => from, "name" => to}),
    do: with({:ok, to} <- name(to), do: Edit.rename_track(layer, to_string(from), to))

  defp change(_, _, _), do: bad()

  @doc """
  Gives a stream of annotations another schema: what the page has edited. Annotations follow what was renamed; a value
  that some of them have cannot be taken away.
  """
  @spec put_schema(pid(), [SchemaForm.attribute()]) :: :ok | {:error, Error.t()}
  def put_schema(editor, draft) do
    with {:ok, schema, renamed} <- SchemaForm.schema(Editor.layer(editor).schema.name, draft),
         names = Enum.map(schema.attributes, & &1.name),
         do: done(Editor.put_schema(editor, schema, &renamed(&1, renamed, names)))
  end

  defp renamed(annotation, renamed, names) do
    values =
      Enum.reduce(renamed, annotation.values, fn {was, now, names}, values ->
        case Map.pop(values, was) do
          {nil, values} -> values
          {value, values} -> Map.put(values, now, Map.get(names, value, value))
        end
      end)

    %{annotation | values: Map.take(values, names)}
  end

  @doc "Proposals out of a stream's segments (`Situ.Studio.Draw.Segments`): what is true, a track for each lane."
  @spec propose(pid(), [tuple()], String.t()) :: :ok | {:error, Error.t()}
  def propose(editor, segments, stream) do
    short = stream |> String.split(".") |> List.last()

    done(
      Editor.edit(editor, fn layer ->
        values = Schema.defaults(layer.schema)

        proposals =
          for {from, to, _, class, lane} <- segments, class in ["true", "span"], to != nil do
            track = if lane == "", do: short, else: lane
            Annotation.new(from, to, track, values, proposed?: true, by: stream)
          end

        Edit.propose(layer, proposals)
      end)
    )
  end

  defp by(name) do
    case name(name) do
      {:ok, name} -> name
      _ -> nil
    end
  end

  defp values(%{} = values), do: Map.filter(values, fn {key, _} -> is_binary(key) end)
  defp values(_), do: %{}

  defp time(text) do
    with :error <- WholeNumber.parse(text), do: bad()
  end

  defp id(id) when is_integer(id), do: {:ok, id}
  defp id(_), do: bad()

  defp name(name) when is_binary(name) do
    name = name |> String.trim() |> String.slice(0, 60)
    if name == "", do: bad(), else: {:ok, name}
  end

  defp name(_), do: bad()

  defp least(x) when is_number(x) and x >= 0 and x <= 1, do: x / 1
  defp least(_), do: 0.0

  defp bad, do: {:error, Error.new(:bad_request, "not an edit of annotations")}
end
