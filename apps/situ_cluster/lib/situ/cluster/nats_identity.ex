defmodule Situ.Cluster.NatsIdentity do
  @moduledoc false
  # Creates the files with which a cluster's nodes and its NATS server authenticate each other: a
  # TLS certificate on each side, and a password. `Situ.Cluster.Identity.create/1` writes them.
  #
  # Each side has its own certificate authority, so the files on the server's machine do not
  # suffice to start a node. The server's files are in a separate folder that can be moved: run
  # `nats-server -c nats-server.conf` in that folder.
  alias Situ.Link.Certificate

  @folder "nats-server"
  @user "situ"

  @doc "Returns the name of the server's folder inside the identity's folder."
  @spec server_folder() :: String.t()
  def server_folder, do: @folder

  @doc "Returns the names and contents of a node's and the server's files; the certificates are valid for `days`."
  @spec issue_files(pos_integer()) :: {[{String.t(), String.t()}], [{String.t(), String.t()}]}
  def issue_files(days) do
    server = Certificate.issue_pem("the NATS server of a cluster of Situ", days: days)
    node = Certificate.issue_pem("a node at its NATS server", days: days)
    password = Base.encode32(:crypto.strong_rand_bytes(30), case: :lower, padding: false)

    {[
       {"nats.pem", node.certificate},
       {"nats.key", node.key},
       {"nats-ca.pem", server.authority},
       {"nats-credentials", "#{@user}:#{password}\n"}
     ],
     [
       {"server.pem", server.certificate},
       {"server.key", server.key},
       {"clients.pem", node.authority},
       {"nats-server.conf", server_config(password)}
     ]}
  end

  defp server_config(password) do
    """
    # NATS for the log of a cluster of Situ. Move this folder to the server's machine, keep it readable for its owner
    # only, and start the server in it: nats-server -c nats-server.conf
    #
    # A program must show a certificate that clients.pem has signed, and know the password.
    listen: "0.0.0.0:4222"
    jetstream { store_dir: "data" }
    tls {
      cert_file: "server.pem"
      key_file: "server.key"
      ca_file: "clients.pem"
      verify: true
      timeout: 10
    }
    authorization { user: "#{@user}", password: "#{password}" }
    """
  end

  @doc "Returns the options of `Situ.Cluster.Log.connect/2` for the files in `identity`; `verify` checks the server."
  @spec log_options(Path.t(), {fun(), term()}) :: keyword()
  def log_options(identity, verify) do
    file = &Path.join(identity, &1)

    if File.exists?(file.("nats.pem")) do
      # The server's authority signs no other certificate, so the server's machine may have any name.
      tls = [
        cacertfile: file.("nats-ca.pem"),
        certfile: file.("nats.pem"),
        keyfile: file.("nats.key"),
        verify: :verify_peer,
        verify_fun: verify
      ]

      [credentials: file.("nats-credentials"), tls: tls]
    else
      []
    end
  end
end
