defmodule Situ.CLI.Serve do
  @moduledoc false
  # `situ serve`: serves a recording to other machines.
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Option, Output, Token, Verb}
  alias Situ.{Error, Link}
  alias Situ.Link.{Address, Server}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["serve"],
        summary: "serve a recording to other machines, even while it is being recorded",
        about: """
        Serves until it is stopped (Ctrl-C). A name without a version means all of its versions, including future ones;
        if no version exists yet, it waits for the first. On another machine, a pipeline opens the printed address:
        Situ.Link.open(p, ADDRESS, from: :resume). The studio and `situ store` open the same address as a recording;
        they read the token from SITU_TOKEN, or from the file that SITU_TOKEN_FILE names. See the guide "Links between
        machines".
        """,
        arguments: [path: [kind: :recording, doc: "a recording, or the name of its versions"]],
        options: [
          Option.new(:port, :integer, "listen on this port; 0 selects a free one",
            default: Address.default_port()
          ),
          Option.new(
            :listen,
            :string,
            "listen on this address; other addresses than the default require a token",
            value: "ADDRESS",
            default: "127.0.0.1"
          ),
          Token.token_option(),
          Option.new(:unix, :path, "also listen on a Unix socket with this path"),
          Option.new(:tls, :flag, "use TLS with a certificate generated for this machine"),
          Option.new(:certificate, :path, "use TLS with this certificate (PEM)"),
          Option.new(:key, :path, "the certificate's key (PEM)"),
          Option.new(
            :bytes_per_second,
            :integer,
            "maximum rate for all clients together"
          )
        ],
        examples: [
          "situ serve recordings/robot",
          "situ serve recordings/robot --listen 0.0.0.0 --tls --token-file secret"
        ],
        run: fn %{path: path}, opts -> serve_recording(path, opts) end
      }
    ]
  end

  defp serve_recording(path, opts) do
    # Recordings of other systems can be served as well.
    for app <- [:situ_bridge, :situ_link], do: {:ok, _} = Application.ensure_all_started(app)
    Process.flag(:trap_exit, true)

    with {:ok, tls} <- tls_settings(opts),
         {:ok, token} <- Token.read_token(opts),
         {:ok, server} <- Link.serve(path, server_settings(opts, tls, token)) do
      Output.puts("Situ serves #{path} at #{served_address(path, server, opts)}")
      wait_for_exit(server)
    else
      {:error, error} -> raise error
    end
  end

  defp server_settings(opts, tls, token) do
    limit = opts[:bytes_per_second]
    quota = if limit, do: {:bytes_per_second, limit}

    [port: opts[:port], interface: opts[:listen], wait: true] ++
      [tls: tls, token: token, unix: opts[:unix], quota: quota]
  end

  defp tls_settings(opts) do
    case {opts[:certificate], opts[:key]} do
      {nil, nil} ->
        {:ok, opts[:tls] || nil}

      {certificate, key} when is_binary(certificate) and is_binary(key) ->
        {:ok, [certfile: certificate, keyfile: key]}

      _ ->
        {:error,
         Error.new(:usage, "--certificate and --key must be given together",
           fix: "name both files"
         )}
    end
  end

  defp served_address(path, server, opts) do
    name = path |> Path.basename() |> String.replace(~r/\.\d{4,}$/, "")
    Server.address(server, name) || "the socket #{opts[:unix]}"
  end

  defp wait_for_exit(server) do
    receive do
      {:EXIT, ^server, reason} ->
        Output.warn("situ serve: the server ended: #{inspect(reason)}")
        1
    end
  end
end
