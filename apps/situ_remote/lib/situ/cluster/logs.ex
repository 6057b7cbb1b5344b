defmodule Situ.Cluster.Logs do
  @moduledoc """
  The last lines that each node has logged, to be read from any of them: `bin/situ cluster logs`.

  A handler of Erlang's logger keeps the last 2,000 lines of a node in a table. Lines are texts of 4,000 characters at
  most; they were written for people, and whoever has the cluster's cookie may read them.
  """
  @keep 2_000
  @most_characters 4_000
  # Under this key stands the last number; all others are numbers.
  @counter :last

  @typedoc "`n` grows by one from line to line; `time` is ns since 1970."
  @type line :: %{n: pos_integer(), time: Situ.Time.t(), level: atom(), text: String.t()}

  @doc "Begins to keep lines; the table belongs to the calling process and ends with it."
  @spec start() :: :ok
  def start do
    if :ets.whereis(__MODULE__) == :undefined do
      :ets.new(__MODULE__, [:named_table, :public, :ordered_set])
      :ets.insert(__MODULE__, {@counter, 0})
    end

    _ = :logger.remove_handler(__MODULE__)
    # That a supervisor has started something (for each connection of TLS) is no news.
    filters = [progress: {&:logger_filters.progress/2, :stop}]
    :logger.add_handler(__MODULE__, __MODULE__, %{level: :info, filters: filters})
  end

  @doc "The lines behind number `from`, the oldest first, at most `most` of the newest."
  @spec read(non_neg_integer(), pos_integer()) :: [line()]
  def read(from \\ 0, most \\ @keep) do
    rows =
      :ets.select(__MODULE__, [
        {{:"$1", :"$2"}, [{:is_integer, :"$1"}, {:>, :"$1", from}], [{{:"$1", :"$2"}}]}
      ])

    for {n, {time, level, text}} <- Enum.take(rows, -most),
        do: %{n: n, time: time, level: level, text: text}
  rescue
    # This node is no member (any more).
    ArgumentError -> []
  end

  # Called by logger, in the process that logs.
  @doc false
  @spec log(:logger.log_event(), :logger.handler_config()) :: term()
  def log(%{level: level, meta: %{time: time}} = event, _config) do
    text =
      event
      |> :logger_formatter.format(%{single_line: true, template: [:msg]})
      |> IO.chardata_to_string()
      |> String.slice(0, @most_characters)

    n = :ets.update_counter(__MODULE__, @counter, 1)
    :ets.insert(__MODULE__, {n, {time * 1_000, level, text}})
    :ets.delete(__MODULE__, n - @keep)
  rescue
    # The table ends with its node's membership, and a line is no reason to fail.
    _ in [ArgumentError, UnicodeConversionError] -> :ok
  end
end
