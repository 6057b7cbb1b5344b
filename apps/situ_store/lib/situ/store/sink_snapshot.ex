defmodule Situ.Store.SinkSnapshot do
  @moduledoc false
  # Takes the checkpoint of a sink, and continues from it in a new recording, perhaps on another node of a cluster. The
  # checkpoint refers to the messages in the previous recording, which are copied into the new one. If the new node
  # cannot read the previous recording, the new one begins at the checkpoint.
  # See docs/adr/0202-a-recorder-continues-in-a-copy.md.
  alias Situ.{Columns, Error}
  alias Situ.Store.{Query, SharedWriter, StreamInfo, Transfer, Writer}
  require Logger

  @typedoc """
  `span`: the first and last originating time of the stream; `pending`: the messages that are not in the recording yet;
  `closed`: when the stream has ended.
  """
  @type t :: %{
          node: node(),
          path: Path.t(),
          stream: String.t(),
          span: {Situ.Time.t(), Situ.Time.t()} | nil,
          pending: [Situ.Message.t()],
          closed: Situ.Time.t() | nil
        }

  @doc "Returns the checkpoint of a stream whose messages, except `pending`, are committed."
  @spec new(
          SharedWriter.t(),
          Writer.Stream.t(),
          {Situ.Time.t(), Situ.Time.t()} | nil,
          [Situ.Message.t()],
          Situ.Time.t() | nil
        ) :: t()
  def new(shared, stream, span, pending, closed) do
    %{
      node: node(),
      path: Path.expand(shared.writer.path),
      stream: stream.name,
      span: span,
      pending: pending,
      closed: closed
    }
  end

  @doc """
  Brings the messages of a checkpoint into the new, empty `stream`. Returns the stream, and the times of the messages
  that it has now.
  """
  @spec restore(t(), Writer.Stream.t()) ::
          {:ok, Writer.Stream.t(), {Situ.Time.t(), Situ.Time.t()} | nil} | {:error, Error.t()}
  def restore(%{pending: pending} = snapshot, stream) do
    with {:ok, stream, span} <- copy_messages(snapshot, stream),
         {:ok, stream} <- Writer.append(stream, pending),
         do: {:ok, stream, extend_span(span, pending)}
  end

  @doc "Returns the first and last time after these messages or columns were added."
  @spec extend_span({Situ.Time.t(), Situ.Time.t()} | nil, [Situ.Message.t()] | Columns.t()) ::
          {Situ.Time.t(), Situ.Time.t()} | nil
  def extend_span(span, []), do: span

  def extend_span(span, %Columns{times: <<first::little-signed-64, _::binary>> = times}) do
    <<last::little-signed-64>> = binary_part(times, byte_size(times), -8)
    {if(span, do: elem(span, 0), else: first), last}
  end

  def extend_span(nil, [%{originating_time: first} | _] = messages),
    do: extend_span({first, first}, messages)

  def extend_span({first, _}, messages), do: {first, List.last(messages).originating_time}

  defp copy_messages(%{span: nil}, stream), do: {:ok, stream, nil}

  # Nothing had been committed yet.
  defp copy_messages(%{span: {first, _}, pending: [%{originating_time: first} | _]}, stream),
    do: {:ok, stream, nil}

  defp copy_messages(%{span: {_, last} = span, pending: pending} = snapshot, stream) do
    stored_until = if pending == [], do: last, else: hd(pending).originating_time - 1

    case find_source(snapshot) do
      {:ok, source} ->
        with {:ok, stream} <- Transfer.continue_stream(stream, source, stored_until),
             do: {:ok, stream, span}

      :error ->
        Logger.warning(missing_text(snapshot, stream, stored_until))
        {:ok, stream, nil}
    end
  end

  # Another disk may have another recording at the same path, so the times are compared.
  defp find_source(%{path: path, stream: name, span: {first, last}, pending: pending}) do
    with {:ok, store} <- Query.open(path),
         %StreamInfo{first: oldest} = info when oldest <= first <-
           Enum.find(Query.streams(store), &(&1.name == name)),
         true <- pending != [] or stored_at?(store, info, last) do
      {:ok, {store, info}}
    else
      _ -> :error
    end
  end

  defp stored_at?(store, info, time) do
    with {:ok, ordinal} <- Query.seek_ordinal(store, info, time),
         {:ok, next} <- Query.seek_ordinal(store, info, time + 1),
         do: next == ordinal + 1
  end

  defp missing_text(%{span: {first, _}} = snapshot, stream, until) do
    "#{stream.writer.path}: stream #{stream.name} continues without the messages from #{first} to #{until} ns, " <>
      "because this node cannot read #{snapshot.path} of #{snapshot.node}. To join both, copy that recording here, " <>
      "cut it where this one begins (`situ store crop`), and use `situ store concat`."
  end
end
