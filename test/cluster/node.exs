# One node: joins the cluster on this machine, and stays.
[log, labels | peers] = System.argv()
for peer <- peers, do: Node.connect(String.to_atom(peer))
{:ok, _} = Situ.Cluster.start_link(log: log, labels: String.split(labels, ",", trim: true))
IO.puts("up")
Process.sleep(:infinity)
