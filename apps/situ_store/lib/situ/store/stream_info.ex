defmodule Situ.Store.StreamInfo do
  @moduledoc """
  Describes a stored stream, as `Situ.Store.streams/1` and `Situ.Store.stream_info/2` return it. The values are always
  exact, even while the store is being written or after its writer was killed.

      iex> alias Situ.Store.StreamInfo
      iex> info = %StreamInfo{id: 1, name: "Level", count: 5, first: 0, last: 2_000_000_000}
      iex> {StreamInfo.message_rate(info), StreamInfo.duration(info), StreamInfo.closed?(info)}
      {2.0, 2_000_000_000, false}

  Times are in nanoseconds and sizes in bytes.

    * `type` is a `Situ.Type`; `:any` if the recorded type (`type_name`) names a module that this system does not have
    * `first`, `last`: originating times; `first_creation`, `last_creation`: creation times; `nil` without messages
    * `size`: payload bytes; `stored`: bytes on disk after compression, including tables and index
    * `latency_sum`: the sum of creation minus originating time over all messages
    * `closed`: the originating time at which the stream closed, or `nil`
    * `fields`: field names of the messages' struct, if the messages are structs stored as terms
    * `extra`: facts that the recording's module adds for its own use
  """
  alias Situ.Error
  alias Situ.Store.TermCodec

  @enforce_keys [:id, :name]
  defstruct [
    :id,
    :name,
    :store_name,
    :store_path,
    :opened,
    :closed,
    :first,
    :last,
    :first_creation,
    :last_creation,
    :module,
    :fields,
    :supplemental,
    type: :any,
    type_name: ":any",
    count: 0,
    size: 0,
    stored: 0,
    latency_sum: 0,
    large?: false,
    compression: :none,
    codecs: %{},
    extra: %{}
  ]

  @type t :: %__MODULE__{}

  @doc "Returns messages per second over the recorded time span, or `nil` for fewer than two messages."
  @spec message_rate(t()) :: float() | nil
  def message_rate(%{count: count, first: first, last: last}) when count > 1 and last > first,
    do: (count - 1) * 1.0e9 / (last - first)

  def message_rate(_), do: nil

  @doc "Returns the average payload size, or `nil`."
  @spec average_size(t()) :: float() | nil
  def average_size(%{count: 0}), do: nil
  def average_size(info), do: info.size / info.count

  @doc "Returns the average latency in ns, or `nil`."
  @spec average_latency(t()) :: float() | nil
  def average_latency(%{count: 0}), do: nil
  def average_latency(info), do: info.latency_sum / info.count

  @doc "Returns the last minus the first originating time, or 0 without messages."
  @spec duration(t()) :: Situ.Time.duration()
  def duration(%{first: nil}), do: 0
  def duration(info), do: info.last - info.first

  @doc """
  Returns the supplemental metadata as plain data, which is safe even for a hostile file. Returns the error
  `:no_metadata` if there is none, or `:damaged` if it cannot be decoded.
  """
  @spec metadata(t()) :: {:ok, term()} | {:error, Error.t()}
  def metadata(%{supplemental: nil, name: name}),
    do: {:error, Error.new(:no_metadata, "stream #{inspect(name)} has no metadata")}

  def metadata(%{supplemental: {_type, bytes}, name: name}) do
    with {:error, reason} <- TermCodec.decode(bytes) do
      {:error,
       Error.new(:damaged, "the metadata of #{inspect(name)} cannot be decoded", why: reason)}
    end
  end

  @doc "Returns whether the stream was closed properly."
  @spec closed?(t()) :: boolean()
  def closed?(info), do: info.closed != nil
end
