defmodule Situ.CLI.Store.Messages do
  @moduledoc false
  # `situ store messages`: a line for each.
  alias Situ.CLI.Store.{Arguments, Data}
  alias Situ.{Message, Store, Time}

  @spec run(Store.t(), String.t(), keyword(), keyword()) :: 0
  def run(store, stream, span, opts) do
    store
    |> Store.messages(stream, Arguments.damage(opts) ++ span)
    |> Stream.take(opts[:number] || 10)
    |> Enum.each(&IO.puts(if opts[:json], do: json(&1), else: line(&1)))

    0
  end

  defp line(message) do
    latency = Message.latency(message)
    sign = if latency < 0, do: "", else: "+"

    "#{Time.to_iso8601(message.originating_time)}  #{sign}#{Time.format_duration(latency)}  #{Data.text(message.data)}"
  end

  defp json(message) do
    message
    |> Map.take([:originating_time, :creation_time, :sequence_id])
    |> Map.merge(Data.json(message.data))
    |> Situ.JSON.encode()
  end
end
