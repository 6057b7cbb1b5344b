defmodule Situ.Bridge.Mqtt.Reason do
  @moduledoc false
  # The texts of reason codes: MQTT 5 has one table for all packets, and MQTT 3.1.1 a short one for CONNACK.

  @old %{
    1 => "it does not support MQTT 3.1.1",
    2 => "it rejects the client identifier",
    3 => "it is not available",
    4 => "the user name or the password is wrong",
    5 => "this user is not authorized"
  }

  @texts %{
    0x04 => "it disconnects and publishes the will",
    0x10 => "there are no matching subscribers",
    0x11 => "there was no such subscription",
    0x80 => "it gives no reason",
    0x81 => "a packet is malformed",
    0x82 => "the client violates the protocol",
    0x83 => "its implementation refuses",
    0x84 => "it does not support this version of MQTT",
    0x85 => "it rejects the client identifier",
    0x86 => "the user name or the password is wrong",
    0x87 => "this user is not authorized",
    0x88 => "it is not available",
    0x89 => "it is busy",
    0x8A => "this client is banned",
    0x8B => "it is shutting down",
    0x8C => "it does not support the authentication method",
    0x8D => "the connection was idle for too long",
    0x8E => "another client with the same identifier took over the session",
    0x8F => "the topic filter is invalid",
    0x90 => "the topic is invalid",
    0x91 => "the packet identifier is in use",
    0x92 => "the packet identifier is unknown",
    0x93 => "more messages are in flight than it allows",
    0x94 => "the topic alias is invalid",
    0x95 => "the packet is too large",
    0x96 => "messages arrive too fast",
    0x97 => "a quota is exceeded",
    0x98 => "an administrator closed the connection",
    0x99 => "the payload does not have the announced format",
    0x9A => "it does not support retained messages",
    0x9B => "it does not support this quality of service",
    0x9C => "another server must be used for now",
    0x9D => "another server must be used",
    0x9E => "it does not support shared subscriptions",
    0x9F => "the rate of connections is exceeded",
    0xA0 => "the connection lasted too long",
    0xA1 => "it does not support subscription identifiers",
    0xA2 => "it does not support wildcards"
  }

  @doc """
  Describes a reason code of a broker, with the broker's own words if it sent any.

      iex> Situ.Bridge.Mqtt.Reason.describe(0x87, %{reason_string: "no entry in acl.conf"})
      "this user is not authorized: no entry in acl.conf (code 0x87)"
  """
  @spec describe(byte(), map()) :: String.t()
  def describe(code, properties \\ %{})
  def describe(code, _properties) when is_map_key(@old, code), do: @old[code]

  def describe(code, properties) do
    text = Map.get(@texts, code, "it refuses")

    words =
      for name <- [:reason_string, :server_reference], text = properties[name], do: ": " <> text

    "#{text}#{words} (code 0x#{Base.encode16(<<code>>)})"
  end
end
