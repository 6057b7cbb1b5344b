defmodule Situ.CLI.Store.Messages do
  @moduledoc false
  # `situ store messages`: prints one line per message. Several streams are merged in order of time and labeled.
  alias Situ.CLI.{Data, Output}
  alias Situ.CLI.Store.{Arguments, Tape}
  alias Situ.{Message, Store, Time}

  @spec run(Store.Handle.t(), [String.t()], keyword()) :: 0
  def run(store, streams, opts) do
    reading = Arguments.damage(opts) ++ Arguments.times(opts)
    all = for name <- streams, do: {name, Store.messages(store, name, reading)}
    several? = length(streams) > 1

    all
    |> Tape.merge(& &1.originating_time)
    |> limited(opts[:number])
    |> Enum.each(fn {name, message} ->
      name = if several?, do: name
      if opts[:json], do: Output.json(json(message, name)), else: Output.puts(line(message, name))
    end)

    0
  end

  defp limited(messages, 0), do: messages
  defp limited(messages, n), do: Stream.take(messages, n)

  defp line(message, name) do
    latency = Message.latency(message)
    sign = if latency < 0, do: "", else: "+"
    name = if name, do: "#{Output.name(name)}  ", else: ""
    time = Time.to_iso8601(message.originating_time)
    "#{time}  #{sign}#{Time.format_duration(latency)}  #{name}#{Data.text(message.data)}"
  end

  defp json(message, name) do
    message
    |> Map.take([:originating_time, :creation_time, :sequence_id])
    |> Map.merge(Data.json(message.data))
    |> Map.merge(if(name, do: %{stream: name}, else: %{}))
  end
end
