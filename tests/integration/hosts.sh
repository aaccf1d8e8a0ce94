# Runs a script as on a host `head` beside the hosts `node1` and `node2`, on which sshd or Slurm runs.
#
#   unshare --net --mount --uts --pid --fork --mount-proc --kill-child sh hosts.sh FOLDER KIND SCRIPT
#
# KIND is ssh, which needs the keys of FOLDER, or slurm. They share files and processes, and all end with the script;
# nothing outside sees them. FOLDER is the script's, too, and its HOME.
set -e
folder=$1
ip link set lo up
ip link add net type veth peer name rest        # Slurm asks for an address that is not of the loopback
ip link set net up
mount -t tmpfs run /run
echo '127.0.0.1 localhost' >/run/hosts
for host in 1:head 2:node1 3:node2; do
    ip addr add "10.0.0.${host%:*}/24" dev net
    echo "10.0.0.${host%:*} ${host#*:}" >>/run/hosts
done
mount --bind /run/hosts /etc/hosts
hostname head

if [ "$2" = ssh ]; then
    mkdir -m 755 /run/sshd
    cat >/run/sshd.conf <<END
HostKey "$folder/.ssh/host"
AuthorizedKeysFile "$folder/.ssh/id_ed25519.pub"
StrictModes no
UsePAM no
PidFile none
SetEnv "PATH=$PATH" "PYTHONPATH=$PYTHONPATH" "RAYNESTD=$RAYNESTD" "RAYNEST_BUILTIN_PACKS=$RAYNEST_BUILTIN_PACKS" "TMPDIR=$TMPDIR"
END
    /usr/sbin/sshd -f /run/sshd.conf -E /run/sshd.log
else
    mkdir -p /run/munge /run/slurm/state /run/slurm/node1 /run/slurm/node2
    chmod 755 /run/munge
    head -c 1024 /dev/urandom >/run/munge/key
    chmod 600 /run/munge/key
    munged --force --key-file=/run/munge/key --socket=/run/munge/munge.socket.2 --pid-file=/run/munge/pid \
        --log-file=/run/munge/log --seed-file=/run/munge/seed
    export SLURM_CONF=/run/slurm/slurm.conf
    cat >$SLURM_CONF <<'END'
ClusterName=hosts
SlurmctldHost=head
SlurmUser=root
AuthType=auth/munge
CredType=cred/munge
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
StateSaveLocation=/run/slurm/state
SlurmdSpoolDir=/run/slurm/%n
SlurmdPidFile=/run/slurm/%n.pid
SlurmctldPidFile=/run/slurm/head.pid
SlurmctldLogFile=/run/slurm/head.log
SlurmdLogFile=/run/slurm/%n.log
SlurmdParameters=config_overrides
SchedulerParameters=sched_min_interval=0
NodeName=node1 Port=17001 CPUs=2
NodeName=node2 Port=17002 CPUs=2
PartitionName=all Nodes=ALL Default=YES
END
    slurmctld
    for host in node1 node2; do unshare --uts sh -c "hostname $host && slurmd"; done
    tries=300
    until [ "$(sinfo --noheader --format %D --states idle 2>/run/slurm/said)" = 2 ]; do
        tries=$((tries - 1))
        [ $tries -gt 0 ] || { cat /run/slurm/said /run/slurm/*.log >&2; exit 1; }
        sleep 0.1
    done
fi
unset SSH_AUTH_SOCK
cd "$folder"
HOME=$folder exec sh -ec "$3"
