defmodule Situ.Annotation.Recording do
  @moduledoc """
  Reads annotations from a stream of a recording, and writes them to a separate store next to the annotated recording.

      {:ok, layer} = Situ.Annotation.Recording.load_layer(store, "Speech")
      {:ok, path} = Situ.Annotation.Recording.write(layer, "study/p01/annotation", "Speech")

  A stored version never changes. Writing atomically creates a new version (`annotation.0001`, `annotation.0002`
  ...), so every earlier state can still be opened. The recording of the session is never modified, and it may still
  be in progress. The schema is stored as supplemental metadata of the stream, in its JSON form.
  """
  alias Situ.{Annotation, Error, Store}
  alias Situ.Annotation.{Layer, Psi, Review, Schema}
  alias Situ.Dataset.StoreVersion
  alias Situ.EditLog.Mark

  @type_wanted {:list, Annotation}

  @doc "Returns whether a stored stream contains annotations of Situ or \\psi, by its type or its metadata."
  @spec annotation_stream?(Store.t(), Store.StreamInfo.t()) :: boolean()
  def annotation_stream?(%Situ.Recording{} = store, %Store.StreamInfo{} = info),
    do:
      info.type == @type_wanted or Psi.annotation_stream?(info) or
        match?({:ok, _}, read_schema(store, info))

  @doc "Returns the schema that the stream was recorded with. Errors: `:no_metadata`, `:bad_schema`."
  @spec read_schema(Store.t(), Store.name()) :: {:ok, Schema.t()} | {:error, Error.t()}
  def read_schema(%Situ.Recording{} = store, stream) do
    with {:ok, term} <- Store.metadata(store, stream) do
      case Psi.convert_schema(term) do
        {:ok, json} -> Schema.parse(json)
        :error -> Schema.parse(term)
      end
    end
  end

  @doc """
  Reads the annotations of a stream and its schema, which is guessed from the values if the stream has none.

  Errors: the errors of the store, and `:bad_annotation` if a message is not a list of annotations.
  """
  @spec load_layer(Store.t(), Store.name()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def load_layer(%Situ.Recording{} = store, stream) do
    with {:ok, info} <- Store.stream_info(store, stream),
         {:ok, annotations} <- read_annotations(store, info),
         {:ok, schema} <- schema_or_guess(store, info, annotations),
         do: Layer.new(schema, annotations, read_review(store, info))
  end

  defp read_review(store, info) do
    case Store.metadata(store, info) do
      {:ok, %{"review" => review}} -> Review.from_json(review)
      _ -> %{}
    end
  end

  defp schema_or_guess(store, info, annotations) do
    with {:error, _} <- read_schema(store, info),
         do: Schema.guess_from_values(info.name, Enum.map(annotations, & &1.values))
  end

  @doc "Reads the annotations of a stream without their schema. Takes the options of `Situ.Store.messages/3`."
  @spec read_annotations(Store.t(), Store.name(), keyword()) ::
          {:ok, [Annotation.t()]} | {:error, Error.t()}
  def read_annotations(%Situ.Recording{} = store, stream, opts \\ []) do
    store
    |> Store.messages(stream, opts)
    |> Enum.reduce_while({:ok, []}, fn message, {:ok, done} ->
      case message_annotations(message) do
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

  defp message_annotations(%{data: %{} = set} = message) do
    case Psi.decode_annotations(set) do
      {:ok, list} -> message_annotations(%{message | data: list})
      :error -> bad_message_error(message.originating_time)
    end
  end

  defp message_annotations(%{data: list, originating_time: time}) when is_list(list) do
    if Enum.all?(list, &match?(%Annotation{to: ^time}, &1)) and
         Enum.all?(list, &(Annotation.check_fields(&1) == :ok)),
       do: {:ok, list},
       else: bad_message_error(time)
  end

  defp message_annotations(%{originating_time: time}), do: bad_message_error(time)

  defp bad_message_error(time) do
    {:error,
     Error.new(
       :bad_annotation,
       "the message at #{Situ.Time.to_iso8601(time)} is not a list of annotations",
       why:
         "a message of an annotation stream must be the list of the annotations that end at its time",
       fix: "choose an annotation stream"
     )}
  end

  @doc "Writes the layer as stream `stream` of a new version of the store `ROOT/NAME`; returns `{:ok, folder}`."
  @spec write(Layer.t(), Path.t(), String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def write(%Layer{} = layer, path, stream), do: write_all(%{stream => layer}, path)

  @doc "Writes several layers as streams of a new version of the store; returns `{:ok, folder}`."
  @spec write_all(%{String.t() => Layer.t()}, Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def write_all(layers, path) do
    path = Path.expand(path)
    unmarked = Map.new(layers, fn {stream, layer} -> {stream, {layer, nil}} end)
    with {:ok, draft} <- write_draft(unmarked, path), do: StoreVersion.publish_draft(draft, path)
  end

  @doc false
  # Returns the position in the log of edits that a stored stream contains (`Situ.Annotation.StoreVersions`).
  @spec read_mark(Store.t(), Store.StreamInfo.t()) :: map() | nil
  def read_mark(store, info) do
    case Store.metadata(store, info) do
      {:ok, %{"edits" => mark}} -> Mark.parse(mark)
      _ -> nil
    end
  end

  @doc false
  # Writes several layers with their marks as the version after the folder `base` (`nil` for the first version).
  # Returns the error `:newer_version` and writes nothing if another program has saved a version after `base`.
  @spec write_after(%{String.t() => {Layer.t(), map() | nil}}, Path.t(), Path.t() | nil) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def write_after(layers, path, base) do
    path = Path.expand(path)

    with {:ok, draft} <- write_draft(layers, path),
         {:error, %Error{code: :newer_version}} = error <-
           StoreVersion.publish_after(draft, path, base) do
      _ = Store.delete(draft)
      error
    end
  end

  defp write_draft(layers, path) do
    options = [durability: :each, versioned: false]

    folder = StoreVersion.draft_path(path)

    with {:ok, writer} <- Store.Writer.create(Path.basename(path), folder, options),
         {:filled, _, :ok} <- {:filled, writer, write_streams(writer, Enum.sort(layers))} do
      {:ok, writer.path}
    else
      {:filled, writer, {:error, error}} ->
        discard_draft(writer, error)

      {:error, error} ->
        # If the disk is full, the folder must not remain either.
        StoreVersion.discard_draft(folder)
        {:error, error}
    end
  end

  defp write_streams(writer, []), do: Store.Writer.close(writer)

  defp write_streams(writer, [{stream, {layer, mark}} | rest]) do
    messages = layer |> Layer.annotations() |> Annotation.to_messages()
    options = [type: @type_wanted, metadata: layer |> layer_metadata() |> put_mark(mark)]

    with {:ok, stream} <- Store.Writer.stream(writer, stream, options),
         {:ok, stream} <- Store.Writer.append(stream, messages),
         {:ok, _} <- Store.Writer.close_stream(stream, end_time(messages)),
         do: write_streams(writer, rest)
  end

  # The outcome of a review is next to the fields of the schema.
  defp layer_metadata(%{schema: schema, review: review}) when review == %{},
    do: Schema.to_json(schema)

  defp layer_metadata(%{schema: schema, review: review}),
    do: Map.put(Schema.to_json(schema), "review", Review.to_json(review))

  defp put_mark(metadata, nil), do: metadata
  defp put_mark(metadata, mark), do: Map.put(metadata, "edits", mark)

  defp end_time([]), do: 0
  defp end_time(messages), do: List.last(messages).originating_time

  # An unfinished store must not become a version.
  defp discard_draft(writer, error) do
    _ = Store.Writer.close(writer)
    _ = Store.delete(writer.path)
    {:error, error}
  end
end
