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
  alias Situ.Studio.Annotating.{Proposals, Request, SchemaForm, Shelf}
  alias Situ.Studio.Catalog

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
      recovered: status.recovered,
      shadowed: status.shadowed && Path.basename(status.shadowed)
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
    do: done(Editor.edit(editor, &Request.change(name, &1, params)))

  def edit(_, _), do: bad()

  defp done({:ok, _}), do: :ok
  defp done(error), do: error

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

  @doc """
  Proposals out of a stream's intervals, a track for each lane: `{:ok, how_many}`. A state or a text that the schema
  knows is the value; one that it does not know is no proposal. Those that overlap with annotations are left out.
  """
  @spec propose(pid(), [Proposals.t()], String.t()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def propose(editor, found, stream) do
    short = stream |> String.split(".") |> List.last()
    before = editor |> Editor.layer() |> Layer.annotations() |> length()

    edit = fn layer ->
      proposals =
        for one <- found, values = proposed(layer.schema, one.label) do
          track = if one.lane == "", do: short, else: one.lane
          more = [proposed?: true, by: stream, confidence: one.confidence]
          Annotation.new(one.from, one.to, track, values, more)
        end

      Edit.propose(layer, proposals)
    end

    with {:ok, layer} <- Editor.edit(editor, edit),
         do: {:ok, length(Layer.annotations(layer)) - before}
  end

  defp proposed(schema, ""), do: Schema.defaults(schema)

  defp proposed(%{attributes: attributes} = schema, label) do
    known = Enum.find(attributes, fn a -> Enum.any?(a.values, &(&1.value == label)) end)

    case known || Enum.find(attributes, &(&1.kind == :text)) do
      nil -> nil
      attribute -> Map.put(Schema.defaults(schema), attribute.name, label)
    end
  end

  defp bad, do: {:error, Error.new(:bad_request, "not an edit of annotations")}
end
