defmodule Situ.Studio.Recordings.Origin do
  @moduledoc false
  # Reads streams of recordings that combine others. The information on such a stream contains its origin: the other
  # recording and the stream's information there.
  alias Situ.{Error, Message, Recording}
  alias Situ.Store.{Query, StreamInfo, Summary}

  @doc "Adds the origin of a stream to its information, which then describes the stream of the combining recording."
  @spec put_origin(StreamInfo.t(), Recording.t()) :: StreamInfo.t()
  def put_origin(%StreamInfo{} = info, recording),
    do: %{info | extra: Map.put(info.extra, :origin, {recording, info})}

  @spec seek(StreamInfo.t(), Situ.Time.t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def seek(%{extra: %{origin: {recording, info}}}, time),
    do: Query.seek_ordinal(recording, info, time)

  @spec read(
          StreamInfo.t(),
          non_neg_integer(),
          Situ.Time.t() | :unbounded,
          pos_integer(),
          keyword()
        ) ::
          {:ok, [Message.t()], non_neg_integer()} | {:error, Error.t()}
  def read(%{extra: %{origin: {recording, info}}}, ordinal, to, limit, opts),
    do: Query.read_batch(recording, info, ordinal, to, limit, opts)

  @spec summary(StreamInfo.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, pos_integer(), [tuple()]} | {:error, Error.t()}
  def summary(%{extra: %{origin: {recording, info}}}, from, to, pixels),
    do: Summary.read_numbers(recording, info, from, to, pixels)

  @spec tracks(StreamInfo.t(), Situ.Time.t(), Situ.Time.t(), non_neg_integer(), non_neg_integer()) ::
          {:ok, [tuple()], [tuple()]} | {:error, Error.t()}
  def tracks(%{extra: %{origin: {recording, info}}}, from, to, level, most),
    do: Summary.read_tracks(recording, info, from, to, level, most)
end
