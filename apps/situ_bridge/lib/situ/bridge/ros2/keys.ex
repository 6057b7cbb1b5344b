defmodule Situ.Bridge.Ros2.Keys do
  @moduledoc false
  # The names of topics and of those who use them on Zenoh, as `rmw_zenoh` has them. Pure.
  alias Situ.Bridge.Ros.Definition

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
  The key at which a service is asked.

      iex> Situ.Bridge.Ros2.Keys.service(0, "/add", "example_interfaces/srv/AddTwoInts", "RIHS01_x")
      "0/add/example_interfaces::srv::dds_::AddTwoInts_/RIHS01_x"
  """
  @spec service(non_neg_integer(), String.t(), String.t(), String.t()) :: String.t()
  def service(domain, service, type, hash),
    do: "#{domain}/#{String.trim_leading(service, "/")}/#{dds(type, "srv")}/#{hash}"

  @doc """
  A type's name in keys.

      iex> Situ.Bridge.Ros2.Keys.dds("std_msgs/msg/String")
      "std_msgs::msg::dds_::String_"
  """
  @spec dds(String.t(), kind :: String.t()) :: String.t()
  def dds(type, kind \\ "msg") do
    [package, name] = type |> Definition.plain() |> String.split("/", parts: 2)
    "#{package}::#{kind}::dds_::#{name}_"
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

  @doc """
  The token by which an end of a topic, or of a service, is seen. A topic with a depth keeps that many messages for
  those who come later (durability TRANSIENT_LOCAL).
  """
  @spec token(
          :publisher | :subscriber | :server | :client,
          non_neg_integer(),
          String.t(),
          String.t(),
          {String.t(), String.t(), String.t(), depth :: pos_integer() | nil}
        ) ::
          String.t()
  def token(role, domain, session, node, {topic, type, hash, depth}) do
    type = dds(type, if(role in [:server, :client], do: "srv", else: "msg"))

    "@ros2_lv/#{domain}/#{session}/0/1/#{kind(role)}/%/%/#{mangled(node)}/%#{mangled(topic)}/#{type}/#{hash}/" <>
      qos(depth)
  end

  defp kind(:publisher), do: "MP"
  defp kind(:subscriber), do: "MS"
  defp kind(:server), do: "SS"
  defp kind(:client), do: "SC"

  # Of what is the default nothing is said: reliable, volatile, the last 10.
  defp qos(nil), do: "::,10:,:,:,,"
  defp qos(depth), do: ":1:,#{depth}:,:,:,,"

  defp mangled(name), do: name |> String.trim_leading("/") |> String.replace("/", "%")

  @doc "The attachment of a message: its number, its time, and who sent it."
  @spec attachment(non_neg_integer(), Situ.Time.t(), <<_::128>>) :: binary()
  def attachment(sequence, time, gid),
    do: <<sequence::little-64, time::little-signed-64, 16, gid::binary>>

  @doc "The attachment of an answer to a request with this one; `:error` if that is none."
  @spec reply(binary(), Situ.Time.t()) :: {:ok, binary()} | :error
  def reply(<<sequence::little-64, _time::64, 16, gid::binary-size(16), _::binary>>, time),
    do: {:ok, attachment(sequence, time, gid)}

  def reply(_other, _time), do: :error

  @doc "The time of an attachment, or `nil`."
  @spec time(binary()) :: Situ.Time.t() | nil
  def time(<<_sequence::64, time::little-signed-64, _::binary>>) when time > 0, do: time
  def time(_), do: nil
end
