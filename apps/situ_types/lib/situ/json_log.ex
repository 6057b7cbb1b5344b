defmodule Situ.JsonLog do
  @moduledoc """
  Formats log lines as JSON objects, one on each line, for programs that collect logs.

      config :logger, :console, format: {Situ.JsonLog, :format}, metadata: :all

  The command line does so with `SITU_LOG_FORMAT=json`. Each object has `time` (ISO 8601, UTC), `level` and `message`,
  and the metadata that JSON can represent, such as `pipeline` and `component`. Other values are written as Elixir
  prints them; `mfa`, `pid` and other fields that only the logger needs are left out.

  Lines that a component writes while it handles a message have `pipeline`, `component` and the `originating_time` of
  the message (ISO 8601). If it handles several together, `originating_time` and `last_originating_time` are the times
  of the first and the last of them.

      iex> metadata = [time: 1_700_000_000_123_456, pipeline: "Lobby"]
      iex> line = Situ.JsonLog.format(:error, "no camera", {{2023, 11, 14}, {22, 13, 20, 123}}, metadata)
      iex> IO.iodata_to_binary(line)
      ~s({"time":"2023-11-14T22:13:20.123456Z","level":"error","message":"no camera","pipeline":"Lobby"}\\n)
  """
  @internal [:time, :gl, :mfa, :pid, :erl_level, :domain, :report_cb, :crash_reason] ++
              [
                :module,
                :function,
                :file,
                :line,
                :application,
                :initial_call,
                :callers,
                :ancestors
              ]

  @doc "Formats one log line. The logger calls it; it never raises, because the line would then be lost."
  @spec format(Logger.level(), Logger.message(), Logger.Formatter.date_time_ms(), keyword()) ::
          iodata()
  def format(level, message, timestamp, metadata) do
    fields =
      for {key, value} <- metadata,
          key not in @internal,
          do: {Atom.to_string(key), simplify_value(key, value)}

    own = [
      {"time", format_time(metadata[:time], timestamp)},
      {"level", Atom.to_string(level)},
      {"message", message |> IO.chardata_to_string()}
    ]

    [Situ.JSON.encode({own ++ fields}), "\n"]
  rescue
    error -> "could not format a log line: #{Exception.message(error)}\n"
  end

  # Metadata has the time in microseconds since 1970; the timestamp may be local time.
  defp format_time(us, _timestamp) when is_integer(us),
    do: us |> DateTime.from_unix!(:microsecond) |> DateTime.to_iso8601()

  defp format_time(_us, {date, {h, m, s, ms}}) do
    {date, {h, m, s}}
    |> NaiveDateTime.from_erl!({ms * 1000, 3})
    |> NaiveDateTime.to_iso8601()
  end

  # Components log the originating times of messages, in ns.
  defp simplify_value(key, time)
       when key in [:originating_time, :last_originating_time] and is_integer(time),
       do: Situ.Time.to_iso8601(time)

  defp simplify_value(_key, value), do: simplify_value(value)

  defp simplify_value(value) when is_number(value) or is_boolean(value) or is_nil(value),
    do: value

  defp simplify_value(value) when is_atom(value), do: inspect(value) |> String.trim_leading(":")

  defp simplify_value(value) when is_binary(value),
    do: if(String.valid?(value), do: value, else: inspect(value))

  defp simplify_value(value), do: inspect(value, limit: 50, printable_limit: 500)
end
