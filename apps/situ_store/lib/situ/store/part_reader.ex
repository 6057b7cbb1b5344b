defmodule Situ.Store.PartReader do
  @moduledoc false
  # Reads a stream in parts: columns for plain numbers, lists of messages for everything else.
  alias Situ.{Columns, Message, Options}
  alias Situ.Recording
  alias Situ.Store.{Query, StreamInfo}

  # So many bytes of a file are read together.
  @bytes 1024 * 1024

  @options Keyword.take(Query.message_options(), [:from, :to, :index, :skip_damage])

  @spec column_options() :: Options.schema()
  def column_options, do: @options

  @spec columns(Recording.t(), Query.name(), keyword()) :: Enumerable.t()
  def columns(store, name, opts \\ []) do
    opts = Options.validate!(opts, @options)
    info = Situ.Error.unwrap!(Query.stream_info(store, name))
    to = opts[:to] || :unbounded

    Stream.resource(
      fn -> Query.first_ordinal(store, info, opts) end,
      fn ordinal ->
        case read_part(store, info, ordinal, to, opts) do
          {:ok, [], _} -> {:halt, ordinal}
          {:ok, found, next} -> {[found], next}
          {:error, error} -> raise error
        end
      end,
      fn _ -> :ok end
    )
  end

  # Reads messages if the data is not numeric or is damaged. Reading messages then reports the damage or skips it.
  @spec read_part(
          Recording.t(),
          StreamInfo.t(),
          non_neg_integer(),
          Situ.Time.t() | :unbounded,
          keyword()
        ) ::
          {:ok, Columns.t() | [Message.t()], non_neg_integer()} | {:error, Situ.Error.t()}
  defp read_part(store, info, ordinal, to, opts) do
    found =
      if Recording.implements?(store, :columns, 5),
        do: store.module.columns(store.state, info, ordinal, to, @bytes),
        else: :others

    case found do
      {:ok, _, _} -> found
      :ended -> {:ok, [], ordinal}
      _others_or_damage -> Query.read_batch(store, info, ordinal, to, 1_000, opts)
    end
  end
end
