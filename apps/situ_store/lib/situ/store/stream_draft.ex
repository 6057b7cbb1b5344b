defmodule Situ.Store.StreamDraft do
  @moduledoc false
  # Messages of one stream that wait in native memory for the next commit of their store.
  #
  # Adding messages does not wait for the disk. One commit writes the drafts of all streams, so a store of many slow
  # streams commits once per interval, and not once per stream and interval.
  alias Situ.{Columns, Error, Message}
  alias Situ.Store.{Native, NativeErrors, Writer}

  @enforce_keys [:stream, :ref]
  defstruct [:stream, :ref]
  @type t :: %__MODULE__{stream: Writer.Stream.t(), ref: reference()}

  @doc "Creates the draft of a stream."
  @spec new(Writer.Stream.t()) :: t()
  def new(%Writer.Stream{} = stream),
    do: %__MODULE__{stream: stream, ref: Native.writer_draft(stream.writer.ref, stream.id)}

  @doc """
  Adds messages and returns the number of messages and bytes that wait. Adds none and returns `:refused` if a
  message does not fit: its data is of a different kind than that in the first message, is neither a number, a boolean,
  `nil` nor a short binary, or its time does not increase.
  """
  @spec add(t(), [Message.t()]) :: {non_neg_integer(), non_neg_integer()} | :refused
  def add(draft, messages), do: Native.draft_add(draft.ref, messages)

  @doc "Adds columns with their envelopes, and returns as `add/2` does."
  @spec add_columns(t(), Columns.t()) :: {non_neg_integer(), non_neg_integer()} | :refused
  def add_columns(draft, %Columns{creation_times: creations, sequence_id: id} = columns) do
    parts = {columns.times, columns.values}
    Native.draft_add_columns(draft.ref, columns.kind, parts, creations, id)
  end

  @doc "Returns for how many milliseconds the oldest message has waited, or `nil` if none waits."
  @spec waiting_ms(t()) :: non_neg_integer() | nil
  def waiting_ms(draft), do: Native.draft_waiting(draft.ref)

  @doc "Commits the messages of this draft. After an error they keep waiting."
  @spec commit(t()) :: :ok | {:error, Error.t()}
  def commit(draft), do: commit_drafts(draft, false)

  @doc "Commits the messages of this draft and of all other drafts of the store."
  @spec commit_all(t()) :: :ok | {:error, Error.t()}
  def commit_all(draft), do: commit_drafts(draft, true)

  defp commit_drafts(%{stream: stream, ref: ref}, all?) do
    with {:ok, _} <-
           stream.writer.ref
           |> Native.draft_commit(ref, all?)
           |> NativeErrors.wrap_error(stream.writer.path, stream.name),
         do: :ok
  end
end
