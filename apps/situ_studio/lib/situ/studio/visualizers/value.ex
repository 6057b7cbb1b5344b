defmodule Situ.Studio.Visualizers.Value do
  @moduledoc "Any message at the cursor as a tree of its values."
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, ValueTree, Visualizer}
  alias Situ.Studio.Visualizers.Option

  @impl true
  def about do
    %Visualizer{
      id: "value",
      title: "Value",
      panel: :value,
      shapes: :any,
      options: Option.near(),
      asks: Option.asks()
    }
  end

  @impl true
  def instant(channel, data, message) do
    Frame.json(channel, message.originating_time, %{
      "tree" => ValueTree.of(data),
      "time" => Integer.to_string(message.originating_time),
      "sequence" => message.sequence_id,
      "latency" => Situ.Message.latency(message),
      "type" => type(data)
    })
  end

  defp type(%module{}), do: inspect(module)
  defp type(data) when is_binary(data), do: if(String.valid?(data), do: "string", else: "binary")
  defp type(data) when is_boolean(data), do: "boolean"
  defp type(data) when is_atom(data), do: "atom"
  defp type(data) when is_integer(data), do: "integer"
  defp type(data) when is_float(data), do: "float"
  defp type(data) when is_list(data), do: "list"
  defp type(data) when is_tuple(data), do: "tuple"
  defp type(data) when is_map(data), do: "map"
  defp type(_), do: "term"
end
