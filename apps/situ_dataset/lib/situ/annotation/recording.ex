defmodule Situ.Annotation.Recording do
  @moduledoc """
  Annotations in recordings: read from a stream, written as a store of their own beside what they are about.

      {:ok, layer} = Situ.Annotation.Recording.load(store, "Speech")
      {:ok, path} = Situ.Annotation.Recording.write(layer, "study/p01/annotation", "Speech")

  A store is not changed where it lies. Writing makes a new version (`annotation.0001`, `annotation.0002` ...),
  whole or not at all, so that every earlier state can still be opened; the recording of the session itself is never
  touched, and may be being written meanwhile. The schema is the stream's supplemental metadata, in its JSON form.
  """
  alias Situ.{Annotation, Error, Store}
  alias Situ.Annotation.{Layer, Psi, Schema}
  alias Situ.Dataset.Version

  @type_wanted {:list, Annotation}

  @doc "The `Situ.Type` of an annotation stream."
  @spec type() :: Situ.Type.t()
  def type, do: @type_wanted

  @doc "Whether a stored stream holds annotations (ours or \\psi's): its type says so, or its metadata is a schema."
  @spec annotations?(Store.t(), Store.StreamInfo.t()) :: boolean()
  def annotations?(%Store.Handle{} = store, %Store.StreamInfo{} = info),
    do:
      info.type == @type_wanted or Psi.annotations?(info) or
        match?({:ok, _}, schema(store, info))

  @doc "The schema that the stream was recorded with. Error: `:no_metadata`, `:bad_schema`."
  @spec schema(Store.t(), Store.name()) :: {:ok, Schema.t()} | {:error, Error.t()}
  def schema(%Store.Handle{} = store, stream) do
    with {:ok, term} <- Store.metadata(store, stream) do
      case Psi.schema(term) do
        {:ok, json} -> Schema.parse(json)
        :error -> Schema.parse(term)
      end
    end
  end

  @doc """
  The annotations of a stream, with their schema (guessed from the values when the stream has none).

  Errors: those of the store; `:bad_annotation` when its messages are no annotations.
  """
  @spec load(Store.t(), Store.name()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def load(%Store.Handle{} = store, stream) do
    with {:ok, info} <- Store.stream_info(store, stream),
         {:ok, annotations} <- annotations(store, info),
         {:ok, schema} <- schema_or_guess(store, info, annotations),
         do: Layer.new(schema, annotations)
  end

  defp schema_or_guess(store, info, annotations) do
    with {:error, _} <- schema(store, info),
         do: Schema.guess(info.name, Enum.map(annotations, & &1.values))
  end

  @doc "The annotations of a stream without their schema. Options as `Situ.Store.messages/3`."
  @spec annotations(Store.t(), Store.name(), keyword()) ::
          {:ok, [Annotation.t()]} | {:error, Error.t()}
  def annotations(%Store.Handle{} = store, stream, opts \\ []) do
    store
    |> Store.messages(stream, opts)
    |> Enum.reduce_while({:ok, []}, fn message, {:ok, done} ->
      case of_message(message) do
        {:ok, annotations} -> {:cont, {:ok, [annotations | done]}}
        error -> {:halt, error}
      end
    end)
    |> case do
      {:ok, lists} -> {:ok, lists |> Enum.reverse() |> Enum.concat()}
      error -> error
    end
  rescue
    error in Error -> {:error, error}
  end

  defp of_message(%{data: %{} = set} = message) do
    case Psi.annotations(set) do
      {:ok, list} -> of_message(%{message | data: list})
      :error -> no_annotations(message.originating_time)
    end
  end

  defp of_message(%{data: list, originating_time: time}) when is_list(list) do
    if Enum.all?(list, &match?(%Annotation{to: ^time}, &1)) and
         Enum.all?(list, &(Annotation.check(&1) == :ok)),
       do: {:ok, list},
       else: no_annotations(time)
  end

  defp of_message(%{originating_time: time}), do: no_annotations(time)

  defp no_annotations(time) do
    {:error,
     Error.new(
       :bad_annotation,
       "the message at #{Situ.Time.to_iso8601(time)} holds no annotations",
       why:
         "a message of an annotation stream is the list of the annotations that end at its time",
       fix: "name an annotation stream"
     )}
  end

  @doc "Writes the layer as stream `stream` of a new version of the store at `path` (`ROOT/NAME`): `{:ok, folder}`."
  @spec write(Layer.t(), Path.t(), String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def write(%Layer{} = layer, path, stream), do: write_all(%{stream => layer}, path)

  @doc "The same for several streams of one store."
  @spec write_all(%{String.t() => Layer.t()}, Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def write_all(layers, path) do
    path = Path.expand(path)
    with {:ok, draft} <- draft(layers, path), do: Version.publish(draft, path)
  end

  @doc """
  The same, as the version that follows the folder `base` (`nil` for the first). Error: `:newer_version` when somebody
  saved meanwhile; then nothing was written.
  """
  @spec write_after(%{String.t() => Layer.t()}, Path.t(), Path.t() | nil) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def write_after(layers, path, base) do
    path = Path.expand(path)

    with {:ok, draft} <- draft(layers, path),
         {:error, %Error{code: :newer_version}} = taken <-
           Version.publish_after(draft, path, base) do
      _ = Store.delete(draft)
      taken
    end
  end

  defp draft(layers, path) do
    options = [durability: :each, versioned: false]

    place = Version.draft(path)

    with {:ok, writer} <- Store.Writer.create(Path.basename(path), place, options),
         {:filled, _, :ok} <- {:filled, writer, fill(writer, Enum.sort(layers))} do
      {:ok, writer.path}
    else
      {:filled, writer, {:error, error}} ->
        give_up(writer, error)

      {:error, error} ->
        # of a disk without room not even the folder stays
        Version.discard(place)
        {:error, error}
    end
  end

  defp fill(writer, []), do: Store.Writer.close(writer)

  defp fill(writer, [{stream, layer} | rest]) do
    messages = layer |> Layer.annotations() |> Annotation.messages()
    options = [type: @type_wanted, metadata: Schema.to_json(layer.schema)]

    with {:ok, stream} <- Store.Writer.stream(writer, stream, options),
         {:ok, stream} <- Store.Writer.append(stream, messages),
         {:ok, _} <- Store.Writer.close_stream(stream, ended(messages)),
         do: fill(writer, rest)
  end

  defp ended([]), do: 0
  defp ended(messages), do: List.last(messages).originating_time

  # An unfinished file is no version.
  defp give_up(writer, error) do
    _ = Store.Writer.close(writer)
    _ = Store.delete(writer.path)
    {:error, error}
  end
end
