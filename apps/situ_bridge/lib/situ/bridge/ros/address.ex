defmodule Situ.Bridge.Ros.Address do
  @moduledoc false
  # Where the master is, and under which name others reach this machine.

  @options [
    master: [
      type: {:optional, :string},
      default: nil,
      doc: "The master; else ROS_MASTER_URI, else http://localhost:11311."
    ],
    host: [
      type: {:optional, :string},
      default: nil,
      doc:
        "Under which name others reach this machine; else ROS_HOSTNAME or ROS_IP, with a master on this machine " <>
          "127.0.0.1, else the machine's name."
    ],
    node: [
      type: {:optional, :string},
      default: nil,
      doc: "The node's name, which nobody else may have; by default one is made up."
    ]
  ]

  @enforce_keys [:master, :host, :node]
  defstruct [:master, :host, :node]
  @type t :: %__MODULE__{master: String.t(), host: String.t(), node: String.t()}

  def options, do: @options

  @doc "The address by the options, and the environment."
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

  @doc "A topic's or a service's whole name."
  @spec whole(String.t()) :: String.t()
  def whole("/" <> _ = name), do: name
  def whole(name), do: "/" <> name

  @doc "Where to listen so that they can: this machine only, when that is how it is reached."
  @spec interface(t()) :: String.t()
  def interface(%{host: host}) when host in ["127.0.0.1", "localhost"], do: "127.0.0.1"
  def interface(_), do: "*"
end
