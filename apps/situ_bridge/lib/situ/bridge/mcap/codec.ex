defmodule Situ.Bridge.Mcap.Codec do
  @moduledoc false
  # A channel's bytes as terms, by its message encoding and its schema. Unknown types stay bytes, with a note.
  alias Situ.Bridge.Ros.{Definition, Standard, Wire}

  @type schema :: {name :: String.t(), encoding :: String.t(), data :: binary()} | nil
  @type t :: {:json | :bytes, nil} | {:ros, Definition.t(), Wire.encoding()}

  @doc "How a channel is read, its `Situ.Type`, and a note when its messages stay bytes."
  @spec new(String.t(), schema()) :: {t(), Situ.Type.t(), String.t() | nil}
  def new("json", _schema), do: {{:json, nil}, :any, nil}
  def new("ros1", {name, "ros1msg", text}), do: ros(name, text, :ros1)
  def new("cdr", {name, "ros2msg", text}), do: ros(name, text, :cdr)

  def new(encoding, schema) do
    what = if schema, do: "#{elem(schema, 0)} in #{elem(schema, 1)}", else: "no schema"

    {{:bytes, nil}, :binary,
     "its messages are written as #{inspect(encoding)} (#{what}) and stay bytes"}
  end

  defp ros(name, text, encoding) do
    case Definition.parse(name, text) do
      {:ok, definition} -> {{:ros, definition, encoding}, Standard.type(definition.name), nil}
      {:error, why} -> {{:bytes, nil}, :binary, "its definition cannot be used: #{why}"}
    end
  end

  @doc "Whether its messages may begin with a stamp, and how that is written."
  @spec stamps(t()) :: :ros1_header | :cdr_header | nil
  def stamps({:ros, definition, encoding}) do
    case definition.types[definition.name].fields do
      [{_, {:message, "std_msgs/Header"}} | _] when encoding == :cdr -> :cdr_header
      [{_, {:message, "std_msgs/Header"}} | _] -> :ros1_header
      _ -> nil
    end
  end

  def stamps(_), do: nil

  @doc "One message's data, or why it is none."
  @spec decode(t(), binary()) :: {:ok, term()} | {:error, String.t()}
  def decode({:bytes, _}, bytes), do: {:ok, bytes}

  def decode({:json, _}, bytes) do
    with {:error, _} <- Situ.JSON.decode(bytes), do: {:error, "it is not JSON"}
  end

  def decode({:ros, definition, encoding}, bytes) do
    with {:ok, message} <- Wire.decode(definition, bytes, encoding),
         do: {:ok, Standard.from(definition.name, message)}
  end
end
