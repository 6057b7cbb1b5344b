defmodule Situ.Cluster.Identity do
  @moduledoc """
  Creates and reads the identity that a cluster's nodes share: a cookie, certificates for TLS between them, and the
  files for their own NATS server, in a folder that only its owner can read. Create it once, then copy it to every
  machine.

      :ok = Situ.Cluster.Identity.create("/etc/situ/cluster")
      options = Situ.Cluster.Identity.log_options("/etc/situ/cluster")
      Situ.Cluster.start_link(log: "nats://lab1:4222", log_options: options)

  The folder contains:

      cookie            the secret of Erlang's distribution and of the seals in the log
      ca.pem            the cluster's own authority; certificates of other authorities are rejected
      node.pem/.key     the certificate of every node
      nats.pem/.key     the certificate that a node shows to the NATS server
      nats-ca.pem       the authority of that server
      nats-credentials  user and password for that server
      nats-server/      only for the machine of the NATS server: its configuration and certificates

  `bin/situ cluster` and `bin/situ-node` of a release pass them to Erlang (`rel/overlays/bin/cluster-flags`).
  """
  alias Situ.Error
  alias Situ.Link.Certificate
  alias Situ.Cluster.NatsIdentity

  @days 3_652

  @doc "Creates the folder with the identity; an existing identity is not changed (`:exists`)."
  @spec create(Path.t()) :: :ok | {:error, Error.t()}
  def create(folder) do
    folder = Path.expand(folder)

    if File.exists?(Path.join(folder, "cookie")) do
      {:error,
       Error.new(:exists, "#{folder} already contains the identity of a cluster",
         why: "nodes with a new identity could no longer connect to the existing ones",
         fix: "delete the folder if no cluster uses it, or name another folder"
       )}
    else
      write_identity(folder)
    end
  end

  defp write_identity(folder) do
    issued = Certificate.issue_pem("a cluster of Situ", days: @days)

    {node_files, server_files} = NatsIdentity.issue_files(@days)

    files = [
      {"ca.pem", issued.authority},
      {"node.pem", issued.certificate},
      {"node.key", issued.key},
      {"cookie", Base.encode32(:crypto.strong_rand_bytes(30), case: :lower, padding: false)}
    ]

    with :ok <- File.mkdir_p(folder),
         :ok <- File.chmod(folder, 0o700),
         server = Path.join(folder, NatsIdentity.server_folder()),
         :ok <- File.mkdir_p(server),
         :ok <- File.chmod(server, 0o700),
         :ok <- write_files(server_files, server),
         :ok <- write_files(node_files ++ files, folder) do
      :ok
    else
      {:error, reason} ->
        {:error,
         Error.new(:not_written, "#{folder}: #{:file.format_error(reason)}",
           fix: "name a writable folder"
         )}
    end
  end

  # The permissions are set before the content is written, so that no other user can ever read a file.
  defp write_files(files, folder) do
    Enum.reduce_while(files, :ok, fn {name, text}, :ok ->
      path = Path.join(folder, name)

      with :ok <- File.write(path, ""),
           :ok <- File.chmod(path, 0o600),
           :ok <- File.write(path, text),
           do: {:cont, :ok},
           else: (error -> {:halt, error})
    end)
  end

  # The ssl application calls this function, which cluster-flags names, after it has checked the chain. A node is
  # identified by its certificate, not by the name of its host.
  @doc false
  @spec verify(term(), term(), term()) :: {:valid | :unknown, term()} | {:fail, term()}
  def verify(_certificate, {:bad_cert, :hostname_check_failed}, state), do: {:valid, state}

  # Later versions of OTP report it as a tuple.
  def verify(_certificate, {:bad_cert, reason}, state)
      when is_tuple(reason) and elem(reason, 0) == :hostname_check_failed,
      do: {:valid, state}

  def verify(_certificate, {:bad_cert, reason}, _state), do: {:fail, reason}
  def verify(_certificate, {:extension, _}, state), do: {:unknown, state}
  def verify(_certificate, valid, state) when valid in [:valid, :valid_peer], do: {:valid, state}

  @doc """
  Returns the `log_options:` of `Situ.Cluster.start_link/1` for a NATS server that was set up with this identity, or
  `[]` for an identity without NATS files.
  """
  @spec log_options(Path.t()) :: keyword()
  def log_options(folder), do: NatsIdentity.log_options(folder, {&verify/3, []})

  @doc "Returns the cookie in a folder."
  @spec read_cookie(Path.t()) :: {:ok, atom()} | {:error, Error.t()}
  def read_cookie(folder) do
    case File.read(Path.join(folder, "cookie")) do
      {:ok, text} when byte_size(text) in 8..255 ->
        # Creating an atom is safe here: it is a single one, and the file is our own.
        {:ok, text |> String.trim() |> String.to_atom()}

      _ ->
        {:error,
         Error.new(:no_cookie, "there is no cookie in #{folder}",
           fix: "create one with `situ cluster init`, or copy the folder of another node"
         )}
    end
  end
end
