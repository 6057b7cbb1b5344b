defmodule Situ.Bridge.Ros.Address do
  @moduledoc false
  # Determines the address of the master, and the host name under which other machines reach this one.

  @options [
    master: [
      type: {:optional, :string},
      default: nil,
      doc: "URI of the master. Default: ROS_MASTER_URI, then http://localhost:11311."
    ],
    host: [
      type: {:optional, :string},
      default: nil,
      doc:
        "Name or address under which other machines reach this one. Default: ROS_HOSTNAME, then ROS_IP, then " <>
          "127.0.0.1 if the master is on this machine, then the host name."
    ],
    node: [
      type: {:optional, :string},
      default: nil,
      doc: "Name of the node, which must be unique. Default: a random name."
    ]
  ]

  @enforce_keys [:master, :host, :node]
  defstruct [:master, :host, :node]
  @type t :: %__MODULE__{master: String.t(), host: String.t(), node: String.t()}

  def options, do: @options

  @doc "Builds the address from the options and the environment."
  @spec new(keyword()) :: t()
  def new(opts) do
    master = opts[:master] || System.get_env("ROS_MASTER_URI") || "http://localhost:11311"
    host = opts[:host] || System.get_env("ROS_HOSTNAME") || System.get_env("ROS_IP")

    %__MODULE__{
      master: master,
      host: host || own(URI.parse(master).host),
      node: named(opts[:node])
    }
  end

  defp own(master) when master in ["localhost", "127.0.0.1", "::1", nil], do: "127.0.0.1"

  defp own(_elsewhere) do
    {:ok, name} = :inet.gethostname()
    List.to_string(name)
  end

  defp named(nil), do: "/situ_" <> Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)
  defp named("/" <> _ = name), do: name
  defp named(name), do: "/" <> name

  @doc "Returns the absolute name of a topic or service."
  @spec whole(String.t()) :: String.t()
  def whole("/" <> _ = name), do: name
  def whole(name), do: "/" <> name

  @doc "Returns the interface to listen on: only loopback if other nodes reach this host by a loopback name, else all."
  @spec interface(t()) :: String.t()
  def interface(%{host: host}) when host in ["127.0.0.1", "localhost"], do: "127.0.0.1"
  def interface(_), do: "*"
end
