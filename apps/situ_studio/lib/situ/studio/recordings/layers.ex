defmodule Situ.Studio.Recordings.Layers do
  @moduledoc false
  # Shows the annotation layers of a recording or session as streams (`Annotations.NAME`). While
  # somebody in this studio edits a layer, the stream contains the edits; otherwise, it contains
  # the last saved version.
  @behaviour Situ.Recording

  alias Situ.Annotation
  alias Situ.Annotation.Editor
  alias Situ.{Recording, Store}
  alias Situ.Store.StreamInfo
  alias Situ.Studio.Annotations.{Editors, Home}
  alias Situ.Studio.Recordings

  @prefix "Annotations."

  @enforce_keys [:studio, :home, :cache]
  defstruct [:studio, :home, :cache]

  @type t :: %__MODULE__{studio: String.t(), home: Home.t(), cache: :ets.table()}

  @doc "Adds the layers of a home to a recording; returns the recording without a home."
  @spec add_layers(Recording.t(), String.t(), Home.t() | nil) :: Recording.t()
  def add_layers(recording, _studio, nil), do: recording

  def add_layers(recording, studio, home) do
    cache = :ets.new(__MODULE__, [:set, :public, read_concurrency: true])
    state = %__MODULE__{studio: studio, home: home, cache: cache}
    layers = %Recording{module: __MODULE__, state: state}

    case recording do
      %Recording{module: Recordings.Session, state: %{parts: parts} = session} ->
        %{recording | state: %{session | parts: parts ++ [{@prefix, layers}]}}

      one ->
        Recordings.Session.combine([{"", one}, {@prefix, layers}])
    end
  end

  @doc """
  Returns the name of a layer's stream.

      iex> Situ.Studio.Recordings.Layers.stream_name("Speech.Ada")
      "Annotations.Speech.Ada"
  """
  @spec stream_name(String.t()) :: String.t()
  def stream_name(layer), do: @prefix <> layer

  @impl true
  def info(_state), do: %{name: nil, created: nil, closed?: true, live?: false, damage: []}

  @impl true
  def streams(state) do
    for {store, folder} <- Home.list_versions(state.home),
        name <- list_names(state, {store, folder}),
        do: build_info(state, {store, folder, name})
  end

  defp list_names(state, {store, folder}) do
    fetch_cached(state, {:names, store}, folder, fn ->
      case Store.open(folder) do
        {:ok, store} -> for info <- Store.streams(store), do: info.name
        {:error, _} -> []
      end
    end)
  end

  defp build_info(state, {store, folder, name} = layer) do
    {count, first, last} = fetch_layer(state, layer, :extent)

    %StreamInfo{
      id: nil,
      name: name,
      store_path: store,
      type: {:list, Annotation},
      type_name: "list of Situ.Annotation",
      count: count,
      first: first,
      last: last,
      extra: %{summary: :none, layer: {store, folder, name}}
    }
  end

  # Returns the messages of a layer, or their extent: the number of messages and the first and last time.
  defp fetch_layer(state, {store, folder, name}, what) do
    editor = Editors.find_editor(state.studio, store, name)
    stamp = if editor, do: {editor, Editor.revision(editor)}, else: folder

    fetch_cached(state, {what, store, name}, stamp, fn ->
      load_layer(editor, folder, name, what)
    end)
  catch
    # The editor ended in the meantime.
    :exit, _ -> load_layer(nil, folder, name, what)
  end

  defp load_layer(editor, folder, name, :messages), do: load_messages(editor, folder, name)

  defp load_layer(editor, folder, name, :extent) do
    case load_messages(editor, folder, name) do
      [] ->
        {0, nil, nil}

      [first | _] = messages ->
        {length(messages), first.originating_time, List.last(messages).originating_time}
    end
  end

  defp load_messages(nil, folder, name) do
    with {:ok, store} <- Store.open(folder),
         {:ok, annotations} <- Annotation.Recording.read_annotations(store, name) do
      Annotation.to_messages(annotations)
    else
      {:error, _} -> []
    end
  end

  defp load_messages(editor, _folder, _name) do
    editor
    |> Editor.current_layer()
    |> Annotation.Layer.annotations()
    |> Annotation.to_messages()
  end

  # Keeps one value for each key, until its stamp changes.
  defp fetch_cached(%{cache: cache}, key, stamp, fun) do
    case :ets.lookup(cache, key) do
      [{_, ^stamp, value}] ->
        value

      _ ->
        value = fun.()
        :ets.insert(cache, {key, stamp, value})
        value
    end
  end

  @impl true
  def seek(state, %{extra: %{layer: layer}}, time) do
    {:ok, state |> fetch_layer(layer, :messages) |> Enum.count(&(&1.originating_time < time))}
  end

  @impl true
  def read(state, %{extra: %{layer: layer}}, ordinal, to, limit, _opts) do
    page =
      state
      |> fetch_layer(layer, :messages)
      |> Enum.slice(ordinal, limit)
      |> Enum.take_while(&(to == :unbounded or &1.originating_time <= to))

    {:ok, page, ordinal + length(page)}
  end
end
