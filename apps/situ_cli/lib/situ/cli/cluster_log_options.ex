defmodule Situ.CLI.ClusterLogOptions do
  @moduledoc false
  # The verbs of `situ cluster` log in to a NATS server with the files of the cluster's identity, unless other files are
  # given. Passwords never need to be on the command line, which every user of the machine can read.
  alias Situ.Cluster.Identity
  alias Situ.CLI.{Option, Output}
  alias Situ.Error

  @doc "Returns the command-line options for a log in NATS."
  @spec log_options() :: [Option.t()]
  def log_options do
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
        "with nats://: the certificate authority that signed the server's certificate",
        value: "FILE"
      ),
      Option.new(:log_cert, :path, "with nats://: the client certificate", value: "FILE"),
      Option.new(:log_key, :path, "with nats://: the client certificate's key", value: "FILE"),
      Option.new(
        :log_plain,
        :flag,
        "with nats://: use neither TLS nor the files of the cluster's folder"
      )
    ]
  end

  @doc "Returns the options of the log at an address."
  @spec connect_options(String.t(), keyword(), Path.t()) :: keyword()
  def connect_options("nats://" <> rest, opts, identity) do
    own = if opts[:log_plain], do: [], else: Identity.log_options(identity)
    own = if String.contains?(rest, "@"), do: drop_credentials(own), else: own
    named = for {key, file} <- [credentials: opts[:log_credentials]], file, do: {key, file}
    own |> Keyword.merge(named) |> with_tls(tls_files(opts))
  end

  def connect_options(_folder, opts, _identity) do
    case Enum.find([:log_credentials, :log_ca, :log_cert, :log_key], &opts[&1]) do
      nil ->
        []

      name ->
        raise Error.new(:usage, "a log in a folder does not accept #{flag_name(name)}",
                fix: folder_log_fix()
              )
    end
  end

  defp flag_name(name), do: "--" <> String.replace(Atom.to_string(name), "_", "-")
  defp folder_log_fix, do: "use it with --log nats://host:4222, or omit it"

  # A login in the address works, but other users can read it.
  defp drop_credentials(options) do
    Output.warn(
      "situ cluster: every user of this machine can read the login in --log in the process list;" <>
        " write it to a file and give --log-credentials FILE"
    )

    Keyword.delete(options, :credentials)
  end

  defp tls_files(opts) do
    for {key, file} <- [
          cacertfile: opts[:log_ca],
          certfile: opts[:log_cert],
          keyfile: opts[:log_key]
        ],
        file,
        do: {key, file}
  end

  # With a different certificate authority, the name of the server's machine is verified as well.
  defp with_tls(options, []), do: options

  defp with_tls(options, named) do
    tls = options[:tls] || []
    tls = if named[:cacertfile], do: Keyword.delete(tls, :verify_fun), else: tls
    Keyword.put(options, :tls, Keyword.merge(tls, named))
  end
end
