defmodule Situ.Bridge.Ros2.Keys do
  @moduledoc false
  # The names of topics and of those who use them on Zenoh, as `rmw_zenoh` has them. Pure.
  alias Situ.Bridge.Ros.Definition

  @qos "::,10:,:,:,,"

  @doc """
  The key of a topic's messages; without a type, all of the topic's.

      iex> Situ.Bridge.Ros2.Keys.topic(0, "/chatter", "std_msgs/String", "RIHS01_x")
      "0/chatter/std_msgs::msg::dds_::String_/RIHS01_x"
      iex> Situ.Bridge.Ros2.Keys.topic(0, "/a/b")
      "0/a/b/*/*"
  """
  @spec topic(non_neg_integer(), String.t(), String.t() | nil, String.t() | nil) :: String.t()
  def topic(domain, topic, type \\ nil, hash \\ nil),
    do:
      "#{domain}/#{String.trim_leading(topic, "/")}/#{if type, do: dds(type), else: "*"}/#{hash || "*"}"

  @doc """
  A type's name in keys.

      iex> Situ.Bridge.Ros2.Keys.dds("std_msgs/msg/String")
      "std_msgs::msg::dds_::String_"
  """
  @spec dds(String.t()) :: String.t()
  def dds(type) do
    [package, name] = type |> Definition.plain() |> String.split("/", parts: 2)
    "#{package}::msg::dds_::#{name}_"
  end

  @doc """
  The type that a key names.

      iex> Situ.Bridge.Ros2.Keys.type("0/chatter/std_msgs::msg::dds_::String_/RIHS01_x")
      {:ok, "std_msgs/String"}
      iex> Situ.Bridge.Ros2.Keys.type("0/chatter")
      :error
  """
  @spec type(String.t()) :: {:ok, String.t()} | :error
  def type(key) do
    with [_hash, dds | _] <- key |> String.split("/") |> Enum.reverse(),
         [package, "msg", "dds_", name] <- String.split(dds, "::"),
         true <- String.ends_with?(name, "_") do
      {:ok, package <> "/" <> String.trim_trailing(name, "_")}
    else
      _ -> :error
    end
  end

  @doc "The token by which a node is seen."
  @spec node(non_neg_integer(), String.t(), String.t()) :: String.t()
  def node(domain, session, name), do: "@ros2_lv/#{domain}/#{session}/0/0/NN/%/%/#{mangled(name)}"

  @doc "The token by which a publisher (`:publisher`) or a subscriber is seen."
  @spec token(
          :publisher | :subscriber,
          non_neg_integer(),
          String.t(),
          String.t(),
          {String.t(), String.t(), String.t()}
        ) ::
          String.t()
  def token(role, domain, session, node, {topic, type, hash}) do
    kind = if role == :publisher, do: "MP", else: "MS"

    "@ros2_lv/#{domain}/#{session}/0/1/#{kind}/%/%/#{mangled(node)}/%#{mangled(topic)}/#{dds(type)}/#{hash}/#{@qos}"
  end

  defp mangled(name), do: name |> String.trim_leading("/") |> String.replace("/", "%")

  @doc "The attachment of a message: its number, its time, and who sent it."
  @spec attachment(non_neg_integer(), Situ.Time.t(), <<_::128>>) :: binary()
  def attachment(sequence, time, gid),
    do: <<sequence::little-64, time::little-signed-64, 16, gid::binary>>

  @doc "The time of an attachment, or `nil`."
  @spec time(binary()) :: Situ.Time.t() | nil
  def time(<<_sequence::64, time::little-signed-64, _::binary>>) when time > 0, do: time
  def time(_), do: nil
end
