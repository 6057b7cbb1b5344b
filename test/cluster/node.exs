# One node: joins the cluster on this machine, and runs until its driver has ended for any reason.
[log, labels | peers] = System.argv()
for peer <- peers, do: Node.connect(String.to_atom(peer))
{:ok, _} = Situ.Cluster.start_link(log: log, labels: String.split(labels, ",", trim: true))
IO.puts("up")
IO.read(:stdio, :eof)
System.halt(0)
