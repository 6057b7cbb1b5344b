defmodule Situ.CLI.Store.Messages do
  @moduledoc false
  # `situ store messages`: prints one line per message. Several streams are merged in order of time and labeled.
  alias Situ.CLI.{DataFormat, Output}
  alias Situ.CLI.Store.{Arguments, ItemReader}
  alias Situ.{Message, Store, Time}

  @spec print_messages(Store.t(), [String.t()], keyword()) :: 0
  def print_messages(store, streams, opts) do
    reading = Arguments.damage_options(opts) ++ Arguments.time_options(opts)
    all = for name <- streams, do: {name, Store.messages(store, name, reading)}
    several? = length(streams) > 1

    all
    |> ItemReader.merge(& &1.originating_time)
    |> limit_messages(opts[:number])
    |> Enum.each(fn {name, message} ->
      name = if several?, do: name

      if opts[:json],
        do: Output.print_json(message_json(message, name)),
        else: Output.puts(format_message(message, name))
    end)

    0
  end

  defp limit_messages(messages, 0), do: messages
  defp limit_messages(messages, n), do: Stream.take(messages, n)

  defp format_message(message, name) do
    latency = Message.latency(message)
    sign = if latency < 0, do: "", else: "+"
    name = if name, do: "#{Output.format_name(name)}  ", else: ""
    time = Time.to_iso8601(message.originating_time)

    "#{time}  #{sign}#{Time.format_duration(latency)}  #{name}#{DataFormat.format_line(message.data)}"
  end

  defp message_json(message, name) do
    message
    |> Map.take([:originating_time, :creation_time, :sequence_id])
    |> Map.merge(DataFormat.to_json(message.data))
    |> Map.merge(if(name, do: %{stream: name}, else: %{}))
  end
end
