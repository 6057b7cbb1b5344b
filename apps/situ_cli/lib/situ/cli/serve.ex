defmodule Situ.CLI.Serve do
  @moduledoc "`situ serve`: a recording for other machines."
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Option, Output, Secret, Verb}
  alias Situ.{Error, Remote}
  alias Situ.Remote.{Address, Server}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["serve"],
        summary: "serve a recording to other machines, also while it is recorded",
        about: """
        Serves until it is stopped (Ctrl-C). A name without a version means all of its versions, those that will be
        recorded included; one that has none yet is waited for. Elsewhere a pipeline opens it by the address that is
        printed: Situ.Remote.open(p, ADDRESS, from: :resume). The studio and `situ store` open the same address as a
        recording; they read the token from SITU_TOKEN, or from the file that SITU_TOKEN_FILE names. See the guide
        "Links between machines".
        """,
        arguments: [path: [kind: :recording, doc: "a recording, or the name of its versions"]],
        options: [
          Option.new(:port, :integer, "listen on this port; 0 takes a free one",
            default: Address.default_port()
          ),
          Option.new(
            :listen,
            :string,
            "listen on this address; elsewhere clients must know a token",
            value: "ADDRESS",
            default: "127.0.0.1"
          ),
          Secret.option(),
          Option.new(:unix, :path, "listen on a Unix socket of this path, too"),
          Option.new(:tls, :flag, "speak TLS, by a certificate made for this machine"),
          Option.new(:certificate, :path, "speak TLS by this certificate (PEM)"),
          Option.new(:key, :path, "the certificate's key (PEM)"),
          Option.new(
            :bytes_per_second,
            :integer,
            "send no more than this to all clients together"
          )
        ],
        examples: [
          "situ serve recordings/robot",
          "situ serve recordings/robot --listen 0.0.0.0 --tls --token-file secret"
        ],
        run: fn %{path: path}, opts -> serve(path, opts) end
      }
    ]
  end

  defp serve(path, opts) do
    # Recordings of other systems are served too.
    for app <- [:situ_bridge, :situ_remote], do: {:ok, _} = Application.ensure_all_started(app)
    Process.flag(:trap_exit, true)

    with {:ok, tls} <- tls(opts),
         {:ok, token} <- Secret.token(opts),
         {:ok, server} <- Remote.serve(path, settings(opts, tls, token)) do
      Output.puts("Situ serves #{path} at #{address(path, server, opts)}")
      wait(server)
    else
      {:error, error} -> raise error
    end
  end

  defp settings(opts, tls, token) do
    limit = opts[:bytes_per_second]
    quota = if limit, do: {:bytes_per_second, limit}

    [port: opts[:port], interface: opts[:listen], wait: true] ++
      [tls: tls, token: token, unix: opts[:unix], quota: quota]
  end

  defp tls(opts) do
    case {opts[:certificate], opts[:key]} do
      {nil, nil} ->
        {:ok, opts[:tls] || nil}

      {certificate, key} when is_binary(certificate) and is_binary(key) ->
        {:ok, [certfile: certificate, keyfile: key]}

      _ ->
        {:error, Error.new(:usage, "--certificate and --key go together", fix: "name both files")}
    end
  end

  defp address(path, server, opts) do
    name = path |> Path.basename() |> String.replace(~r/\.\d{4,}$/, "")
    Server.address(server, name) || "the socket #{opts[:unix]}"
  end

  defp wait(server) do
    receive do
      {:EXIT, ^server, reason} ->
        Output.warn("situ serve: the server ended: #{inspect(reason)}")
        1
    end
  end
end
