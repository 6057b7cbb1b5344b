defmodule Situ.CLI.ClusterLog do
  @moduledoc false
  # How the verbs of `situ cluster` log in to a NATS server: by the files of the cluster's identity, unless others are
  # named. No password has to stand on the command line, which every user of the machine can read.
  alias Situ.Cluster.Identity
  alias Situ.CLI.{Option, Output}
  alias Situ.Error

  @doc "The options for a log in NATS."
  @spec options() :: [Option.t()]
  def options do
    [
      Option.new(
        :log_credentials,
        :path,
        "with nats://: a file whose first line is user:password",
        value: "FILE"
      ),
      Option.new(
        :log_ca,
        :path,
        "with nats://: the authority that has signed the server's certificate",
        value: "FILE"
      ),
      Option.new(:log_cert, :path, "with nats://: the certificate to show", value: "FILE"),
      Option.new(:log_key, :path, "with nats://: its key", value: "FILE"),
      Option.new(
        :log_plain,
        :flag,
        "with nats://: use no file of the cluster's folder, and no TLS"
      )
    ]
  end

  @doc "The options of `Situ.Remote.Log.connect/2` for an address."
  @spec connect_options(String.t(), keyword(), Path.t()) :: keyword()
  def connect_options("nats://" <> rest, opts, identity) do
    own = if opts[:log_plain], do: [], else: Identity.log_options(identity)
    own = if String.contains?(rest, "@"), do: drop_credentials(own), else: own
    named = for {key, file} <- [credentials: opts[:log_credentials]], file, do: {key, file}
    own |> Keyword.merge(named) |> with_tls(tls(opts))
  end

  def connect_options(_folder, opts, _identity) do
    case Enum.find([:log_credentials, :log_ca, :log_cert, :log_key], &opts[&1]) do
      nil -> []
      name -> raise Error.new(:usage, "a log that is a folder has no #{flag(name)}", fix: fix())
    end
  end

  defp flag(name), do: "--" <> String.replace(Atom.to_string(name), "_", "-")
  defp fix, do: "give it with --log nats://host:4222, or leave it out"

  # A login in the address works, but other users can read it.
  defp drop_credentials(options) do
    Output.warn(
      "situ cluster: every user of this machine can read the login in --log in the list of processes;" <>
        " write it into a file and give --log-credentials FILE"
    )

    Keyword.delete(options, :credentials)
  end

  defp tls(opts) do
    for {key, file} <- [
          cacertfile: opts[:log_ca],
          certfile: opts[:log_cert],
          keyfile: opts[:log_key]
        ],
        file,
        do: {key, file}
  end

  # With another authority the name of the server's machine is checked, too.
  defp with_tls(options, []), do: options

  defp with_tls(options, named) do
    tls = options[:tls] || []
    tls = if named[:cacertfile], do: Keyword.delete(tls, :verify_fun), else: tls
    Keyword.put(options, :tls, Keyword.merge(tls, named))
  end
end
