defmodule Situ.Studio.Recordings.Layers do
  @moduledoc false
  # Shows the annotation layers of a recording or session as streams (`Annotations.NAME`). While
  # somebody in this studio edits a layer, the stream contains the edits; otherwise, it contains
  # the last saved version.
  @behaviour Situ.Recording

  alias Situ.Annotation
  alias Situ.Annotation.Editor
  alias Situ.{Error, Message, Recording, Store}
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
    # Versions of stores never change, so the data read from them are kept.
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
        name <- list_names(state, folder),
        do: build_info(name, folder, read_messages(state, {store, folder, name}))
  end

  defp list_names(state, folder) do
    fetch_cached(state, folder, fn ->
      case Store.open(folder) do
        {:ok, store} -> for info <- Store.streams(store), do: info.name
        {:error, _} -> []
      end
    end)
  end

  defp build_info(name, folder, messages) do
    %StreamInfo{
      id: nil,
      name: name,
      store_path: folder,
      type: {:list, Annotation},
      type_name: "list of Situ.Annotation",
      count: length(messages),
      first: first_time(messages),
      last: messages |> Enum.take(-1) |> first_time(),
      extra: %{summary: :none, messages: messages}
    }
  end

  defp first_time([]), do: nil
  defp first_time([message | _]), do: message.originating_time

  defp read_messages(state, {store, folder, name}) do
    case Editors.find_editor(state.studio, store, name) do
      nil ->
        fetch_cached(state, {folder, name}, fn -> stored_messages(folder, name) end)

      editor ->
        editor
        |> Editor.current_layer()
        |> Annotation.Layer.annotations()
        |> Annotation.to_messages()
    end
  catch
    # The editor ended in the meantime.
    :exit, _ -> stored_messages(folder, name)
  end

  defp stored_messages(folder, name) do
    with {:ok, store} <- Store.open(folder),
         {:ok, annotations} <- Annotation.Recording.read_annotations(store, name) do
      Annotation.to_messages(annotations)
    else
      {:error, _} -> []
    end
  end

  defp fetch_cached(%{cache: cache}, key, fun) do
    with [] <- :ets.lookup(cache, key) do
      value = fun.()
      :ets.insert(cache, {key, value})
      value
    else
      [{_, value}] -> value
    end
  end

  # The information on a stream contains its messages, so that one request of a page sees one state of the layer.
  @impl true
  def seek(_state, %{extra: %{messages: messages}}, time),
    do: {:ok, Enum.count(messages, &(&1.originating_time < time))}

  @impl true
  @spec read(
          t(),
          StreamInfo.t(),
          non_neg_integer(),
          Situ.Time.t() | :unbounded,
          pos_integer(),
          keyword()
        ) ::
          {:ok, [Message.t()], non_neg_integer()} | {:error, Error.t()}
  def read(_state, %{extra: %{messages: messages}}, ordinal, to, limit, _opts) do
    page =
      messages
      |> Enum.slice(ordinal, limit)
      |> Enum.take_while(&(to == :unbounded or &1.originating_time <= to))

    {:ok, page, ordinal + length(page)}
  end
end
